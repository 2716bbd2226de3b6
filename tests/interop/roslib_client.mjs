// What a program with roslib sees of a station; prints one line of JSON. Runs with 1.x and 2.x.
// usage: node roslib_client.mjs ws://127.0.0.1:9090 [fragments]
const module = await import("roslib");
const ROSLIB = module.Ros ? module : module.default;
const [url, withFragments] = process.argv.slice(2);
const seen = {};
const ros = new ROSLIB.Ros({url});
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const topic = (name, messageType, options = {}) => new ROSLIB.Topic({ros, name, messageType, ...options});
const message = (fields) => ROSLIB.Message ? new ROSLIB.Message(fields) : fields;
const bags = {};
const collect = (key, one) => { bags[key] = []; one.subscribe((m) => bags[key].push(m)); return one; };
const plain = (value) => JSON.parse(JSON.stringify(value, (k, v) => ArrayBuffer.isView(v) ? Array.from(v) : v));
const call = (name, serviceType, request) => new Promise((resolve) => {
  const service = new ROSLIB.Service({ros, name, serviceType});
  const wrapped = ROSLIB.ServiceRequest ? new ROSLIB.ServiceRequest(request) : request;
  service.callService(wrapped, (values) => resolve({ok: true, values}), (error) => resolve({ok: false, error: String(error)}));
});

await new Promise((resolve, reject) => { ros.on("connection", resolve); ros.on("error", reject); });
seen.statuses = [];
const emit = ros.emit.bind(ros);  // a status with an id has an event name of its own
ros.emit = (name, ...rest) => {
  if (String(name).startsWith("status")) seen.statuses.push(rest[0]);
  return emit(name, ...rest);
};
seen.topics = await new Promise((resolve, reject) => ros.getTopics(resolve, reject));
seen.type = await new Promise((resolve, reject) => ros.getTopicType("/dji_sdk/imu", resolve, reject));
seen.services = await new Promise((resolve, reject) => ros.getServices(resolve, reject));

const imu = collect("imu", topic("/dji_sdk/imu", "sensor_msgs/Imu", {throttle_rate: 100}));
collect("attitude_png", topic("/dji_sdk/attitude", "geometry_msgs/QuaternionStamped", {compression: "png", throttle_rate: 100}));
collect("rc_cbor", topic("/dji_sdk/rc", "sensor_msgs/Joy", {compression: "cbor", throttle_rate: 100}));
const slow = collect("slow", topic("/dji_sdk/velocity", "geometry_msgs/Vector3Stamped", {throttle_rate: 500}));
const fast = collect("fast", topic("/dji_sdk/velocity", "geometry_msgs/Vector3Stamped", {throttle_rate: 50}));
if (withFragments) {
  // roslib has no option for it, so it is asked for by hand.
  collect("fragmented", topic("/dji_sdk/gps_position", "sensor_msgs/NavSatFix", {throttle_rate: 100}));
  ros.callOnConnection({op: "subscribe", topic: "/dji_sdk/gps_position", id: "f", fragment_size: 150, throttle_rate: 100});
}
await sleep(2000);
seen.imu_rate = bags.imu.length / 2;
seen.merged_rate = bags.fast.length / 2;
for (const key of ["imu", "attitude_png", "rc_cbor", "fragmented"]) seen[key] = plain(bags[key]?.at(-1) ?? null);
fast.unsubscribe();
slow.unsubscribe();
imu.unsubscribe();

seen.wrong_service = await call("/nothing", "std_srvs/Empty", {});
seen.activation = await call("/dji_sdk/activation", "dji_sdk/Activation", {});
seen.authority = await call("/dji_sdk/sdk_control_authority", "dji_sdk/SDKControlAuthority", {control_enable: 1});

collect("status", topic("/flight_status", "std_msgs/Float32"));
const command = topic("/sdk_request_cmd", "std_msgs/Float32");
command.publish(message({data: 4}));
const end = Date.now() + 60000;
while (Date.now() < end && !bags.status.some((m) => m.data === 3)) await sleep(100);
seen.phases = [...new Set(bags.status.map((m) => m.data))];
const stick = topic("/sdk_request_ctrl", "geometry_msgs/Quaternion");
await sleep(4000);
collect("velocity", topic("/dji_sdk/velocity", "geometry_msgs/Vector3Stamped", {throttle_rate: 50}));
for (let i = 0; i < 40; i++) { stick.publish(message({x: -8, y: 0, z: 0, w: 0})); await sleep(50); }
seen.north = Math.max(...bags.velocity.map((m) => m.vector.y));
stick.unadvertise();
command.unadvertise();
// Types that do not fit are errors that the client is told.
topic("/flight_status", "std_msgs/String").subscribe(() => {});
topic("/nothing", "std_msgs/String").subscribe(() => {});
await sleep(300);
console.log(JSON.stringify(seen));
ros.close();
process.exit(0);
