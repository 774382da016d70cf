// Reads a flight log as viewers do: through its index, with the schemas that it holds, and nothing of ours.
// Prints one line of JSON for each message: topic, schema, times in ns, and the fields that are set.

import { readFile } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

class File {
  constructor(bytes) {
    this.bytes = bytes;
  }
  async size() {
    return BigInt(this.bytes.length);
  }
  async read(offset, length) {
    return this.bytes.subarray(Number(offset), Number(offset + length));
  }
}

const reader = await McapIndexedReader.Initialize({
  readable: new File(new Uint8Array(await readFile(process.argv[2]))),
  decompressHandlers: { zstd: (data) => decompress(data) },
});
const types = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const root = protobuf.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(schema.data));
  types.set(channel.id, { topic: channel.topic, schema: schema.name, type: root.lookupType(schema.name) });
}
const lines = [];
for await (const message of reader.readMessages()) {
  const { topic, schema, type } = types.get(message.channelId);
  const content = type.toObject(type.decode(message.data), { longs: String, enums: String });
  const [log_ns, publish_ns] = [message.logTime, message.publishTime].map(String);
  lines.push(JSON.stringify({ topic, schema, log_ns, publish_ns, content }));
}
process.stdout.write(lines.map((line) => line + "\n").join(""));
