// Reads an MCAP bag with Foxglove's own packages and prints what it finds as JSON lines.
// Usage: node read_bag.mjs FOLDER_WITH_NODE_MODULES FILE.mcap
import { createHash } from "node:crypto";
import { createRequire } from "node:module";
import { open } from "node:fs/promises";
import { join } from "node:path";

const require = createRequire(join(process.argv[2], "package.json"));
const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const readable = new FileHandleReadable(await open(process.argv[3], "r"));
const reader = await McapIndexedReader.Initialize({ readable });
const say = (line) => process.stdout.write(JSON.stringify(line) + "\n");
say({ profile: reader.header.profile, messages: Number(reader.statistics.messageCount) });

const readers = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  const text = new TextDecoder().decode(schema.data);
  readers.set(id, new MessageReader(parse(text, { ros2: true })));
  say({ topic: channel.topic, encoding: channel.messageEncoding, schema: schema.encoding });
}
for await (const message of reader.readMessages()) {
  const { topic } = reader.channelsById.get(message.channelId);
  const value = readers.get(message.channelId).readMessage(message.data);
  if (topic === "/phy124/points") {
    const { sec, nanosec, nsec } = value.header.stamp;
    say({
      topic,
      stamp: [sec, nanosec ?? nsec],
      logTime: String(message.logTime),
      frame: value.header.frame_id,
      width: value.width,
      fields: value.fields.map((field) => [field.name, field.offset, field.datatype, field.count]),
      data: createHash("sha256").update(value.data).digest("hex"),
    });
  } else if (topic.includes("/camera/")) {
    const { height, width, encoding, format, k } = value;
    const data = value.data && createHash("sha256").update(value.data).digest("hex");
    say({ topic, logTime: String(message.logTime), height, width, encoding, format, k, data });
  } else if (topic === "/tf_static") {
    const [{ header, child_frame_id, transform }] = value.transforms;
    say({ topic, parent: header.frame_id, child: child_frame_id, transform });
  }
}
for await (const record of reader.readMetadata({ name: "phy124" })) {
  say({ metadata: Object.fromEntries(record.metadata) });
}
