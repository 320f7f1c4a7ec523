// Reads .mcap files with the readers that Foxglove uses: node read_recordings.mjs FILE...
//
// Each file is read by its index and as a stream, and every message is decoded by the schema in the file.
// Prints a line of JSON for each file. Whatever does not fit together is an error.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { createReadStream } from "node:fs";
import { open } from "node:fs/promises";
import { basename } from "node:path";

import { crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";

const decompressHandlers = { zstd: (data, size) => zstd.decompress(data, Number(size)) };

/** Random access to a file, as the indexed reader wants it. */
class FileReadable {
  constructor(handle) {
    this.handle = handle;
  }

  async size() {
    return BigInt((await this.handle.stat()).size);
  }

  async read(offset, size) {
    const { buffer, bytesRead } = await this.handle.read(
      new Uint8Array(Number(size)),
      0,
      Number(size),
      Number(offset),
    );
    assert.equal(bytesRead, Number(size), `read past the end at ${offset}`);
    return buffer;
  }
}

/** Path and exact content of every value in a message: numbers as doubles, text as UTF-8. */
function* leaves(value, path = "") {
  if (typeof value === "string") {
    yield [path, Buffer.from(value)];
  } else if (ArrayBuffer.isView(value)) {
    yield [path, doubles(value)];
  } else if (Array.isArray(value)) {
    if (value.length === 0) {
      yield [path, Buffer.alloc(0)];
    }
    for (const [index, item] of value.entries()) {
      yield* leaves(item, `${path}[${index}]`);
    }
  } else if (typeof value === "object") {
    for (const [name, item] of Object.entries(value)) {
      // This decoder has a name of its own for a field of builtin_interfaces/Time.
      yield* leaves(item, `${path}.${name === "nsec" ? "nanosec" : name}`);
    }
  } else {
    yield [path, doubles([value])];
  }
}

/** Numbers as little-endian doubles. */
function doubles(values) {
  const content = Buffer.alloc(8 * values.length);
  values.forEach((value, index) => content.writeDoubleLE(Number(value), 8 * index));
  return content;
}

/** What comes on one topic. */
class Topic {
  constructor(schema, channel) {
    assert.equal(schema.encoding, "ros2msg");
    assert.equal(channel.messageEncoding, "cdr");
    this.schema = schema;
    this.channel = channel;
    this.decoder = new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true }));
    this.messages = 0;
    this.content = createHash("sha256");
    this.stamps = createHash("sha256");
  }

  add(message) {
    this.last = this.decoder.readMessage(message.data);
    this.messages += 1;
    this.stamps.update(`${message.sequence} ${message.logTime} ${message.publishTime}\n`);
    for (const [path, content] of leaves(this.last)) {
      this.content.update(`${path} ${content.length}\n`);
      this.content.update(content);
    }
  }

  report() {
    return {
      type: this.schema.name,
      type_hash: this.channel.metadata.get("topic_type_hash"),
      messages: this.messages,
      content: this.content.digest("hex"),
      stamps: this.stamps.digest("hex"),
      last: this.last,
    };
  }
}

/** Topics by name, from channels as they come; the same channel may come again. */
class Topics {
  constructor() {
    this.byName = new Map();
  }

  add(schema, channel, message) {
    if (!this.byName.has(channel.topic)) {
      this.byName.set(channel.topic, new Topic(schema, channel));
    }
    this.byName.get(channel.topic).add(message);
  }

  report() {
    const names = [...this.byName.keys()].sort();
    return Object.fromEntries(names.map((name) => [name, this.byName.get(name).report()]));
  }
}

/** The file by its index: every message in order of time, attachments and metadata. */
async function readIndexed(handle) {
  const readable = new FileReadable(handle);
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  assert.notEqual(reader.footer.summaryCrc, 0, "the summary has no checksum");
  if (reader.dataSectionCrc !== undefined) {
    const data = await readable.read(0n, reader.dataEndOffset);
    assert.equal(crc32Final(crc32Update(crc32Init(), data)), reader.dataSectionCrc, "checksum of the data");
  }
  const topics = new Topics();
  let time = 0n;
  for await (const message of reader.readMessages()) {
    assert.ok(message.logTime >= time, "messages come in order of time");
    time = message.logTime;
    const channel = reader.channelsById.get(message.channelId);
    topics.add(reader.schemasById.get(channel.schemaId), channel, message);
  }
  const attachments = {};
  for await (const attachment of reader.readAttachments()) {
    const { name, mediaType, data } = attachment;
    attachments[name] = { media_type: mediaType, text: new TextDecoder().decode(data) };
  }
  const metadata = {};
  for await (const record of reader.readMetadata()) {
    metadata[record.name] = Object.fromEntries(record.metadata);
  }
  return { reader, topics: topics.report(), attachments, metadata };
}

/** The file from its first byte to its last: every message as it stands, and how many records of each kind. */
async function readStream(path) {
  const reader = new McapStreamReader({ includeChunks: true, decompressHandlers });
  const schemas = new Map();
  const channels = new Map();
  const topics = new Topics();
  const counts = new Map();
  const chunks = [];
  for await (const piece of createReadStream(path)) {
    reader.append(piece);
    for (let record; (record = reader.nextRecord()); ) {
      counts.set(record.type, (counts.get(record.type) ?? 0) + 1);
      if (record.type === "Schema") {
        schemas.set(record.id, record);
      } else if (record.type === "Channel") {
        channels.set(record.id, record);
      } else if (record.type === "Chunk") {
        assert.notEqual(record.uncompressedCrc, 0, "a chunk has no checksum");
        chunks.push({ chunk: record, times: new Map(), indexes: new Map() });
      } else if (record.type === "Message") {
        const channel = channels.get(record.channelId);
        const { times } = chunks.at(-1);
        times.set(record.channelId, [...(times.get(record.channelId) ?? []), record.logTime]);
        topics.add(schemas.get(channel.schemaId), channel, record);
      } else if (record.type === "MessageIndex") {
        chunks.at(-1).indexes.set(record.channelId, record.records);
      }
    }
  }
  assert.ok(reader.done(), "the stream ends before the file is complete");
  return { topics: topics.report(), counts, chunks, schemas, channels };
}

/** Whether each index tells exactly what stands in its chunk. */
function checkIndexes({ chunks }, { chunkIndexes }) {
  assert.equal(chunkIndexes.length, chunks.length);
  for (const [number, { chunk, times, indexes }] of chunks.entries()) {
    const index = chunkIndexes[number];
    for (const name of ["messageStartTime", "messageEndTime", "uncompressedSize", "compression"]) {
      assert.equal(index[name], chunk[name], name);
    }
    assert.equal(index.compressedSize, BigInt(chunk.records.byteLength));
    assert.deepEqual([...index.messageIndexOffsets.keys()].sort(), [...indexes.keys()].sort());
    const found = [...indexes].map(([channel, entries]) => [channel, entries.map(([time]) => time)]);
    assert.deepEqual(new Map(found), times);
  }
}

/** Whether the statistics in the file are those of what was read. */
function checkStatistics({ counts, channels, schemas, topics, chunks }, { statistics }) {
  const messages = [...channels].map(([id, { topic }]) => [id, BigInt(topics[topic]?.messages ?? 0)]);
  const times = chunks.flatMap(({ chunk }) => [chunk.messageStartTime, chunk.messageEndTime]);
  const { type, ...told } = statistics;
  assert.equal(type, "Statistics");
  assert.deepEqual(told, {
    messageCount: BigInt(counts.get("Message") ?? 0),
    schemaCount: schemas.size,
    channelCount: channels.size,
    attachmentCount: counts.get("Attachment") ?? 0,
    metadataCount: counts.get("Metadata") ?? 0,
    chunkCount: chunks.length,
    messageStartTime: times.reduce((least, time) => (time < least ? time : least), times[0] ?? 0n),
    messageEndTime: times.reduce((most, time) => (time > most ? time : most), times[0] ?? 0n),
    // A channel without messages may be left out.
    channelMessageCounts: new Map(
      messages.filter(([id, count]) => count > 0n || statistics.channelMessageCounts.has(id)),
    ),
  });
}

async function read(path) {
  const handle = await open(path);
  try {
    const indexed = await readIndexed(handle);
    const streamed = await readStream(path);
    assert.deepEqual(indexed.topics, streamed.topics);
    checkIndexes(streamed, indexed.reader);
    checkStatistics(streamed, indexed.reader);
    const { profile, library } = indexed.reader.header;
    return {
      file: basename(path),
      profile,
      library,
      chunks: streamed.chunks.length,
      topics: indexed.topics,
      attachments: indexed.attachments,
      metadata: indexed.metadata,
    };
  } finally {
    await handle.close();
  }
}

/** JSON knows neither typed arrays nor numbers that are not finite. */
function plain(_, value) {
  if (ArrayBuffer.isView(value)) {
    return Array.from(value);
  }
  return typeof value === "number" && !Number.isFinite(value) ? String(value) : value;
}

await zstd.isLoaded;
for (const path of process.argv.slice(2)) {
  console.log(JSON.stringify(await read(path), plain));
}
