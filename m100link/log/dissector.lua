-- What follows the tables: made by `m100link log wireshark`, see its manual page.

-- LuaBitOp, Lua 5.2, or the operators of Lua 5.3, which earlier ones cannot even parse.
local bit = bit or bit32 or load([[return {
  band = function(a, b) return a & b end, bxor = function(a, b) return a ~ b end,
  rshift = function(a, n) return a >> n end }]])()

local function crc_table(polynomial)
  local made = {}
  for n = 0, 255 do
    local register = n
    for _ = 1, 8 do
      local low = register % 2
      register = bit.rshift(register, 1)
      if low == 1 then register = bit.bxor(register, polynomial) end
    end
    made[n] = register
  end
  return made
end

local CRC16, CRC32 = crc_table(0xA001), crc_table(0xEDB88320)

local function checksum(steps, bytes)
  local register = M.start
  for n = 1, #bytes do
    local step = steps[bit.band(bit.bxor(register, bytes:byte(n)), 0xFF)]
    register = bit.bxor(bit.rshift(register, 8), step)
  end
  return register % 4294967296
end

local m100 = Proto("m100", "DJI Matrice 100 Onboard API")
local fields, list = {}, {}

local function add_field(kind, abbreviation, name, ...)
  local field = ProtoField[kind](abbreviation, name, ...)
  fields[abbreviation] = field
  list[#list + 1] = field
end

add_field("uint8", "m100.sof", "Start of frame", base.HEX)
add_field("uint16", "m100.length", "Length")
add_field("uint8", "m100.version", "Version")
add_field("uint8", "m100.session", "Session")
add_field("bool", "m100.is_ack", "Ack")
add_field("uint8", "m100.padding", "Padding bytes")
add_field("uint8", "m100.encryption", "Encryption")
add_field("uint16", "m100.sequence", "Sequence number")
add_field("uint16", "m100.crc16", "Header CRC16", base.HEX)
add_field("uint32", "m100.crc32", "Frame CRC32", base.HEX)
add_field("uint8", "m100.cmd_set", "Command set", base.HEX)
add_field("uint8", "m100.cmd_id", "Command id", base.HEX)
add_field("string", "m100.command", "Command")
add_field("bytes", "m100.data", "Data")
add_field("bytes", "m100.ciphertext", "Encrypted data")
add_field("bytes", "m100.no_frame", "Bytes of no frame")
add_field("uint16", "m100.ack_code", "Ack code", base.HEX)
add_field("string", "m100.ack_name", "Ack")
add_field("uint16", "m100.telemetry.flags", "Flags", base.HEX)
for _, one in ipairs(M.fields) do
  if one.kind == "double" or one.kind == "string" or one.kind == "bytes" then
    add_field(one.kind, one.abbreviation, one.name)
  else
    add_field(one.kind, one.abbreviation, one.name, base.DEC, one.words)
  end
end
m100.fields = list

local experts = {
  crc16 = ProtoExpert.new("m100.crc16.wrong", "Header checksum is wrong",
    expert.group.CHECKSUM, expert.severity.ERROR),
  crc32 = ProtoExpert.new("m100.crc32.wrong", "Frame checksum is wrong",
    expert.group.CHECKSUM, expert.severity.ERROR),
  short = ProtoExpert.new("m100.short", "The frame is shorter than its length says",
    expert.group.MALFORMED, expert.severity.ERROR),
  no_frame = ProtoExpert.new("m100.no_frame.found", "Bytes that belong to no frame",
    expert.group.UNDECODED, expert.severity.WARN),
  size = ProtoExpert.new("m100.size.wrong", "The length does not fit the command or the flags",
    expert.group.PROTOCOL, expert.severity.WARN),
  unknown = ProtoExpert.new("m100.command.unknown", "Not a command that is known",
    expert.group.UNDECODED, expert.severity.NOTE),
  padding = ProtoExpert.new("m100.padding.wrong", "Padding without encryption, or more than data",
    expert.group.PROTOCOL, expert.severity.WARN),
  encrypted = ProtoExpert.new("m100.encrypted", "Encrypted: export the log with --key-file",
    expert.group.SECURITY, expert.severity.CHAT),
  orphan = ProtoExpert.new("m100.ack.orphan", "What this ack answers is not in the capture",
    expert.group.SEQUENCE, expert.severity.NOTE),
}
local all = {}
for _, one in pairs(experts) do all[#all + 1] = one end
m100.experts = all

local choices = { { 0, "auto", 0 } }
for number, name in ipairs(M.firmwares) do choices[number + 1] = { number, name, number } end
m100.prefs.firmware = Pref.enum("Firmware", 0,
  "By which telemetry and movement are read; auto: what the capture says, else 1.0",
  choices, false)

local interface = Field.new("frame.interface_description")

local function firmware()
  local chosen = M.firmwares[m100.prefs.firmware]
  if chosen then return chosen end
  local told = interface()
  told = told and tostring(told.value):match("firmware (%S+)")
  return M.telemetry[told] and told or "1.0"
end

-- What was asked, by direction, session and sequence number; and, for who scrolls back, by packet.
local asked, answers = {}, {}
function m100.init() asked, answers = {}, {} end

local function value_of(format, range)
  if format == "f" or format == "d" then return range:le_float() end
  if format == "B" or format == "H" or format == "I" then return range:le_uint() end
  if format == "b" or format == "h" or format == "i" then return range:le_int() end
  if format == "low" then return range:le_uint() % 16 end
  if format == "high" then return math.floor(range:le_uint() / 16) end
end

local function show(tree, tvb, parts)
  for _, part in ipairs(parts) do
    local field = fields[part.abbreviation]
    if part.format == "bytes" then
      if tvb:len() > part.offset then tree:add(field, tvb(part.offset)) end
    elseif part.format == "s" then
      local range = tvb(part.offset, part.many)
      local text = range:raw()
      local ends = text:find("\0", 1, true)
      tree:add(field, range, ends and text:sub(1, ends - 1) or text)
    else
      for n = 0, part.many - 1 do
        local range = tvb(part.offset + n * part.size, part.size)
        tree:add(field, range, value_of(part.format, range))
      end
    end
  end
end

local function show_form(tree, tvb, forms)
  local parts = forms[tvb:len()] or forms[-1]
  if not parts then
    tree:add_proto_expert_info(experts.size)
    return
  end
  show(tree, tvb, parts)
end

local function show_telemetry(tree, tvb)
  if tvb:len() < 2 then
    tree:add_proto_expert_info(experts.size)
    return
  end
  local flags, at, sent = tvb(0, 2):le_uint(), 2, {}
  tree:add_le(fields["m100.telemetry.flags"], tvb(0, 2))
  local known = 0
  for _, item in ipairs(M.telemetry[firmware()]) do
    if math.floor(flags / item.flag) % 2 == 1 then
      known = known + item.flag
      sent[#sent + 1] = { item, at }
      at = at + item.size
    end
  end
  if known ~= flags or at ~= tvb:len() then
    tree:add_proto_expert_info(experts.size,
      "the length or the flags do not fit firmware " .. firmware())
    return
  end
  for _, pair in ipairs(sent) do
    local item, place = pair[1], pair[2]
    local range = tvb(place, item.size)
    show(tree:add(range, item.name), range:tvb(), item.parts)
  end
end

local function show_command(tree, tvb, pinfo, key)
  local set, id = tvb(0, 1):uint(), tvb(1, 1):uint()
  tree:add(fields["m100.cmd_set"], tvb(0, 1))
  tree:add(fields["m100.cmd_id"], tvb(1, 1))
  local number = set * 256 + id
  local command = M.commands[number]
  if not command then
    pinfo.cols.info:set(string.format("unknown 0x%02X/0x%02X", set, id))
    tree:add_proto_expert_info(experts.unknown)
    return
  end
  if not pinfo.visited then asked[key] = number end
  tree:add(fields["m100.command"], tvb(0, 2), command.name)
  pinfo.cols.info:set(command.name)
  local length = tvb:len() - 2
  if number == M.push then
    if length > 0 then show_telemetry(tree, tvb(2):tvb())
    else tree:add_proto_expert_info(experts.size) end
  elseif command.kinds then
    if length < 1 then
      tree:add_proto_expert_info(experts.size)
      return
    end
    tree:add(fields["m100." .. command.name .. ".kind"], tvb(2, 1))
    local forms = command.kinds[tvb(2, 1):uint()]
    if forms then
      if length > 1 then show_form(tree, tvb(3):tvb(), forms)
      else tree:add_proto_expert_info(experts.size) end
    end
  else
    local forms = command.by_firmware and command.by_firmware[firmware()] or command.forms
    if length > 0 then show_form(tree, tvb(2):tvb(), forms)
    elseif not forms[0] and not forms[-1] then tree:add_proto_expert_info(experts.size) end
  end
end

local function show_ack(tree, tvb, pinfo, key)
  if not pinfo.visited then answers[pinfo.number] = asked[key] end
  local command = M.commands[answers[pinfo.number] or -1]
  if not command then
    pinfo.cols.info:set("ack")
    tree:add_proto_expert_info(experts.orphan)
    return
  end
  tree:add(fields["m100.command"], tvb(), command.name)
  pinfo.cols.info:set("ack of " .. command.name)
  local ack = command.ack
  if not ack then return end
  -- A system code is two bytes and stands alone.
  local size = (ack.is_byte and tvb:len() ~= 2 or tvb:len() == 1) and 1 or 2
  if ack.is_byte and tvb:len() == 2 and not M.system[tvb(0, 2):le_uint()] then size = 1 end
  local code = tvb(0, size):le_uint()
  tree:add(fields["m100.ack_code"], tvb(0, size), code)
  local name = ack.codes[code]
  if name then
    tree:add(fields["m100.ack_name"], tvb(0, size), name)
    pinfo.cols.info:append(": " .. name)
  end
  if ack.forms and tvb:len() > size then show_form(tree, tvb(size):tvb(), ack.forms) end
end

function m100.dissector(tvb, pinfo, root)
  pinfo.cols.protocol:set("M100")
  local tree = root:add(m100, tvb())
  local size = tvb:len()
  if size < 12 or tvb(0, 1):uint() ~= 0xAA
      or checksum(CRC16, tvb:raw(0, 10)) ~= tvb(10, 2):le_uint() then
    if size >= 12 and tvb(0, 1):uint() == 0xAA then
      tree:add_proto_expert_info(experts.crc16)
    end
    tree:add(fields["m100.no_frame"], tvb())
    tree:add_proto_expert_info(experts.no_frame)
    pinfo.cols.info:set(size .. " bytes of no frame")
    return size
  end
  local word, session, seal = tvb(1, 2):le_uint(), tvb(3, 1):uint(), tvb(4, 1):uint()
  local length, padding = word % 1024, seal % 32
  local is_ack, encryption = math.floor(session / 32) % 2 == 1, math.floor(seal / 32)
  session = session % 32
  local sequence = tvb(8, 2):le_uint()
  tree:add(fields["m100.sof"], tvb(0, 1))
  tree:add(fields["m100.length"], tvb(1, 2), length)
  tree:add(fields["m100.version"], tvb(2, 1), math.floor(word / 1024))
  tree:add(fields["m100.session"], tvb(3, 1), session)
  tree:add(fields["m100.is_ack"], tvb(3, 1), is_ack)
  tree:add(fields["m100.padding"], tvb(4, 1), padding)
  tree:add(fields["m100.encryption"], tvb(4, 1), encryption)
  tree:add(fields["m100.sequence"], tvb(8, 2), sequence)
  tree:add_le(fields["m100.crc16"], tvb(10, 2))
  pinfo.cols.info:set(is_ack and "ack" or "empty frame")
  if length == 12 and size == 12 then return size end
  if size < length or length < 16 then
    tree:add_proto_expert_info(experts.short)
    pinfo.cols.info:set("cut off")
    return size
  end
  tree:add_le(fields["m100.crc32"], tvb(length - 4, 4))
  if checksum(CRC32, tvb:raw(0, length - 4)) ~= tvb(length - 4, 4):le_uint() then
    tree:add_proto_expert_info(experts.crc32)
    pinfo.cols.info:set("checksum is wrong")
    return size
  end
  local many = length - 16
  if many == 0 then return size end
  if padding > many or (padding > 0 and encryption == 0) then
    tree:add_proto_expert_info(experts.padding)
  end
  if encryption ~= 0 then
    tree:add(fields["m100.ciphertext"], tvb(12, many))
    tree:add_proto_expert_info(experts.encrypted)
    pinfo.cols.info:set((is_ack and "ack, " or "") .. "encrypted")
    return size
  end
  tree:add(fields["m100.data"], tvb(12, many))
  local data = tvb(12, many):tvb()
  local ours = pinfo.p2p_dir
  local theirs = ours == 0 and 1 or ours == 1 and 0 or ours
  local key = string.format(":%d:%d", session, sequence)
  if is_ack then
    show_ack(tree, data, pinfo, theirs .. key)
  elseif many < 2 then
    tree:add_proto_expert_info(experts.size)
  else
    show_command(tree, data, pinfo, ours .. key)
  end
  return size
end

DissectorTable.get("wtap_encap"):add(wtap.USER0, m100)
