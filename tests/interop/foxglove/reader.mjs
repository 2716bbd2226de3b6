// The reader inside Foxglove: messages of a file by topic, by its index.
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { open } from "node:fs/promises";
import zstd from "@foxglove/wasm-zstd";

await zstd.isLoaded;
const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: { zstd: (data, size) => zstd.decompress(data, Number(size)) },
});
const counts = {};
for await (const message of reader.readMessages()) {
  const topic = reader.channelsById.get(message.channelId).topic;
  counts[topic] = (counts[topic] ?? 0) + 1;
}
console.log(JSON.stringify({ counts, profile: reader.header.profile }));
