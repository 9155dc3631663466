/* A controller in JavaScript with nothing but Node.js: a higher cooling setpoint of the core zone in the afternoon.
 *
 * Start a node and the gateway first, in two other terminals:
 *
 *     zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office
 *     zenostat gateway zeromq --node office
 *
 * Then: node zeromq_controller.js (Node.js 18 or newer)
 * Usage: zeromq_controller.js [PUBLISH COMMAND [NODE [NAME]]]
 *
 * The packages `zeromq` and `@msgpack/msgpack` of npm can take the place of the first two parts.
 */

"use strict";

const net = require("node:net");

const [publish = "tcp://127.0.0.1:5556", command = "tcp://127.0.0.1:5557", nodeName = "office", me = "from-javascript"] =
  process.argv.slice(2);
const root = `zenostat/v3/${nodeName}`;
const SETPOINT = "core_zn_cooling_setpoint";

function fail(reason) {
  console.error(reason);
  process.exit(1);
}

// ZeroMQ: what a DEALER and a SUB socket need of ZMTP 3.0 (the specification 23/ZMTP).

const MORE = 1;
const LONG = 2;
const COMMAND = 4;

class Socket {
  constructor(type, endpoint) {
    const [, host, port] = /^tcp:\/\/(.+):(\d+)$/.exec(endpoint) ?? fail(`${endpoint}: tcp://HOST:PORT expected`);
    this.unread = Buffer.alloc(0);
    this.isGreeted = false;
    this.frames = []; // of the message that is arriving
    this.messages = [];
    this.waiting = []; // calls of receive
    this.connection = net.connect(Number(port), host);
    this.connection.setNoDelay(true);
    this.connection.on("error", (error) => fail(`${endpoint}: ${error.message}; does the gateway run?`));
    this.connection.on("end", () => fail(`${endpoint}: the gateway has closed the connection`));
    this.connection.on("data", (bytes) => this.read(bytes));
    this.ready = new Promise((resolve) => (this.onReady = resolve));
    const greeting = Buffer.alloc(64); // signature, version 3.0, the mechanism NULL
    greeting.set([0xff, 0, 0, 0, 0, 0, 0, 0, 0, 0x7f, 3, 0]);
    greeting.write("NULL", 12);
    this.connection.write(greeting);
    const length = Buffer.from([0, 0, 0, type.length]);
    this.write(COMMAND, Buffer.concat([Buffer.from("\x05READY\x0bSocket-Type"), length, Buffer.from(type)]));
  }

  write(flags, body) {
    const head = Buffer.alloc(9);
    head[0] = flags | LONG;
    head.writeBigUInt64BE(BigInt(body.length), 1);
    this.connection.write(Buffer.concat([head, body]));
  }

  read(bytes) {
    this.unread = Buffer.concat([this.unread, bytes]);
    if (!this.isGreeted) {
      if (this.unread.length < 64) return;
      this.isGreeted = true;
      this.unread = this.unread.subarray(64);
    }
    for (;;) {
      const isLong = this.unread[0] & LONG;
      const head = isLong ? 9 : 2;
      if (this.unread.length < head) return;
      const size = isLong ? Number(this.unread.readBigUInt64BE(1)) : this.unread[1];
      if (this.unread.length < head + size) return;
      this.frame(this.unread[0], this.unread.subarray(head, head + size));
      this.unread = this.unread.subarray(head + size);
    }
  }

  frame(flags, body) {
    if (flags & COMMAND) {
      const name = body.toString("latin1", 1, 1 + body[0]);
      if (name === "READY") this.onReady();
      if (name === "PING") this.write(COMMAND, Buffer.concat([Buffer.from("\x04PONG"), body.subarray(7)]));
      return;
    }
    this.frames.push(body);
    if (flags & MORE) return;
    const message = this.frames;
    this.frames = [];
    if (this.waiting.length) this.waiting.shift()(message);
    else this.messages.push(message);
  }

  async send(...frames) {
    await this.ready;
    frames.forEach((frame, index) => this.write(index < frames.length - 1 ? MORE : 0, frame));
  }

  async receive() {
    return this.messages.shift() ?? new Promise((resolve) => this.waiting.push(resolve));
  }

  async subscribe(topic) {
    await this.send(Buffer.from(`\x01${topic}`));
  }
}

// msgpack

function encode(value) {
  const sized = (kind, length) => {
    const head = Buffer.alloc(5);
    head[0] = kind;
    head.writeUInt32BE(length, 1);
    return head;
  };
  if (typeof value === "number") return sized(0xce, value); // a natural number
  if (typeof value === "string") return Buffer.concat([sized(0xdb, Buffer.byteLength(value)), Buffer.from(value)]);
  if (Buffer.isBuffer(value)) return Buffer.concat([sized(0xc6, value.length), value]);
  if (Array.isArray(value)) return Buffer.concat([sized(0xdd, value.length), ...value.map(encode)]);
  const entries = Object.entries(value);
  return Buffer.concat([sized(0xdf, entries.length), ...entries.flat().map(encode)]);
}

function decode(bytes) {
  let at = 0;
  const take = (length) => bytes.subarray(at, (at += length));
  const natural = (length) => take(length).readUIntBE(0, length);
  const text = (length) => take(length).toString();
  const list = (length) => Array.from({ length }, value);
  const map = (length) => Object.fromEntries(Array.from({ length }, () => [value(), value()]));
  const kinds = {
    0xc0: () => null, 0xc2: () => false, 0xc3: () => true,
    0xc4: () => take(natural(1)), 0xc5: () => take(natural(2)), 0xc6: () => take(natural(4)),
    0xca: () => take(4).readFloatBE(), 0xcb: () => take(8).readDoubleBE(),
    0xcc: () => natural(1), 0xcd: () => natural(2), 0xce: () => natural(4),
    0xcf: () => Number(take(8).readBigUInt64BE()),
    0xd0: () => take(1).readInt8(), 0xd1: () => take(2).readInt16BE(), 0xd2: () => take(4).readInt32BE(),
    0xd3: () => Number(take(8).readBigInt64BE()),
    0xd9: () => text(natural(1)), 0xda: () => text(natural(2)), 0xdb: () => text(natural(4)),
    0xdc: () => list(natural(2)), 0xdd: () => list(natural(4)),
    0xde: () => map(natural(2)), 0xdf: () => map(natural(4)),
  };
  function value() {
    const kind = natural(1);
    if (kind <= 0x7f) return kind;
    if (kind <= 0x8f) return map(kind & 0x0f);
    if (kind <= 0x9f) return list(kind & 0x0f);
    if (kind <= 0xbf) return text(kind & 0x1f);
    if (kind >= 0xe0) return kind - 256;
    return kinds[kind]();
  }
  return value();
}

// The controller

async function main() {
  const published = new Socket("SUB", publish);
  const requests = new Socket("DEALER", command);

  /* Send a request and return the reply; exit with the reason if it is an error. */
  async function ask(key, fields = {}) {
    await requests.send(Buffer.from(`${root}/${key}`), encode(fields));
    const [, encoding, payload] = await requests.receive();
    const reply = decode(payload);
    if (encoding.toString().endsWith(".ErrorReply")) fail(`${reply.error}: ${reply.message}`);
    return reply;
  }

  /* Return the next sample; exit with the reason if the episode has failed or the node has stopped. */
  async function nextSample() {
    for (;;) {
      const [topic, , payload] = await published.receive();
      const message = decode(payload);
      if (topic.toString().endsWith("/sample")) return message;
      if (["failed", "stopped"].includes(message.kind)) fail(message.text);
    }
  }

  await published.subscribe(`${root}/sample`);
  await published.subscribe(`${root}/event`);
  const actuators = (await ask("manifest")).actuators.map((actuator) => actuator.name);
  const setpoint = actuators.indexOf(SETPOINT);
  if (setpoint < 0) fail(`the node has no actuator ${SETPOINT}`);
  let sample = await nextSample(); // a new subscriber receives the latest sample
  await ask(`rpc/claim/${me}`, { controller: me, actuators: [SETPOINT] });
  while (!(sample.flags[0] & 2)) { // 2: the run period is over
    const values = Buffer.alloc(8 * actuators.length);
    const operations = Buffer.alloc(actuators.length); // 0: keep, 1: set, 2: relinquish
    values.writeDoubleLE(sample.time[0].slice(11, 13) >= "12" ? 26.0 : 24.0, 8 * setpoint);
    operations[setpoint] = 1;
    const { episode, step } = sample;
    await ask(`command/${me}`, { episode, step, operations, values });
    while (sample.episode[0] === episode[0] && sample.step[0] === step[0]) sample = await nextSample();
  }
  const source = sample.sources[sample.source_index.readUInt16LE(2 * setpoint)];
  console.log(`${sample.step[0]} timesteps to ${sample.time[0]}, ${SETPOINT} by ${source}`);
  process.exit(0);
}

main();
