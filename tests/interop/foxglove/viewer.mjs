// Foxglove's own client of its protocol: subscribes to everything, prints what came, ends.
import protocols from "@foxglove/ws-protocol"; // CommonJS
import WebSocket from "ws";

const [address, protocol] = process.argv.slice(2);
const client = new protocols.FoxgloveClient({ ws: new WebSocket(address, [protocol]) });
const topics = new Map(), counts = {};

function end(status) {
  console.log(JSON.stringify({ counts }));
  process.exit(status);
}

setTimeout(() => end(1), 20000);
client.on("error", (error) => { console.error(error); end(1); });
client.on("advertise", (channels) => {
  for (const channel of channels) {
    topics.set(client.subscribe(channel.id), channel.topic);
    counts[channel.topic] = 0;
  }
});
client.on("message", (event) => {
  JSON.parse(new TextDecoder().decode(event.data));
  counts[topics.get(event.subscriptionId)] += 1;
  if (counts["/m100/telemetry"] >= 50) end(0);
});
