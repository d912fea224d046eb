// Opens a bag as Foxglove does, with its own libraries: node check.mjs FILE.mcap LAYOUT.json
//
// Every message is decoded by the definition that the bag carries, and every path that the layout plots is
// looked up in them. Prints one line of JSON: messages by topic, and what was wrong.

import { open, readFile } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import zstd from "@foxglove/wasm-zstd";

const [bag, layoutFile] = process.argv.slice(2);

/** Topic and names of fields of a path such as /uav1/odom.pose.pose.position.z or /x.status[:]{name=="a"}.level */
function parts(path) {
  const [, topic, rest] = /^([^.[{]+)(.*)$/.exec(path);
  const plain = rest.replace(/\{[^}]*\}/g, "").replace(/\.@\w+(\([^)]*\))?/g, "");
  return { topic, fields: [...plain.matchAll(/\.(\w+)/g)].map((found) => found[1]) };
}

function has(message, fields) {
  let here = message;
  for (const field of fields) {
    if (Array.isArray(here)) here = here[0];
    if (here == undefined || !(field in here)) return false;
    here = here[field];
  }
  return here != undefined;
}

const layout = JSON.parse(await readFile(layoutFile, "utf8"));
const wanted = Object.values(layout.configById).flatMap((panel) => (panel.paths ?? []).map((one) => one.value));
const panels = Object.values(layout.configById).flatMap((panel) => Object.keys(panel.topics ?? {}));

await zstd.isLoaded;
const file = await open(bag);
const { size } = await file.stat();
const readable = {
  size: async () => BigInt(size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, buffer.length, Number(offset));
    return buffer;
  },
};
const decompressHandlers = { zstd: (data, length) => zstd.decompress(data, Number(length)) };
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });

const readers = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  readers.set(id, new MessageReader(parse(text, { ros2: true })));
}
const counts = {};
const found = new Set();
let last = 0n;
const wrong = [];
for await (const record of reader.readMessages()) {
  const { topic } = reader.channelsById.get(record.channelId);
  const message = readers.get(record.channelId).readMessage(record.data);
  counts[topic] = (counts[topic] ?? 0) + 1;
  if (record.logTime < last) wrong.push(`${topic}: time goes back to ${record.logTime}`);
  last = record.logTime;
  for (const path of wanted) {
    const { topic: of, fields } = parts(path);
    if (of === topic && !found.has(path) && has(message, fields)) found.add(path);
  }
}
for (const path of wanted) if (!found.has(path)) wrong.push(`${path}: not in the bag`);
for (const topic of panels) if (!(topic in counts)) wrong.push(`${topic}: not in the bag`);
await file.close();
console.log(JSON.stringify({ counts, paths: wanted.length, wrong }));
