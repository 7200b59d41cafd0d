#!/bin/sh
# The clock of a SIMATIC S7, set and read by @st-one-io/nodes7 1.1.2 (Node.js), at a server of this script that keeps the ten octets of
# the request as a CPU does: century, year, month, day, hour, minute, second, two octets of milliseconds with the weekday, in BCD.
# Needs Node 20 with npm.
# Guess: setTime() sends the time that it gets, so that getTime() gives it back to the millisecond.
# The octet of the last millisecond digit and the weekday is written over the seconds (and its BCD is formed a second time), the octet
# where it belongs stays 0: 14:05:09.123 on a Sunday becomes 14:05:49.120. At the digits 7 to 9 the seconds are no valid BCD.
# getTime() is right. So a CPU that is set once an hour jumps by up to a minute, without an error.
# dpstack ppi set-time sends the octets in their order.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
(cd "$dir" && npm install --silent --no-audit --no-fund --ignore-scripts @st-one-io/nodes7@1.1.2 >/dev/null 2>&1)
cat >"$dir/try.js" <<'JS'
const assert = require("node:assert");
const net = require("node:net");
const { S7Endpoint } = require("@st-one-io/nodes7");

let clock = Buffer.alloc(10);

// A COTP packet of ISO on TCP with the answer of an S7 CPU
const packet = (pdu) => Buffer.concat([Buffer.from([3, 0, 0, 7 + pdu.length, 2, 0xf0, 0x80]), pdu]);

function answer(request) {
  if (request[5] === 0xe0) {
    // connection request: confirmed, with the references exchanged
    const confirm = Buffer.from(request);
    confirm[5] = 0xd0;
    request.copy(confirm, 6, 8, 10);
    confirm.writeUInt16BE(1, 8);
    return confirm;
  }
  const pdu = request.subarray(7);
  if (pdu[1] === 1) {
    // Setup Communication: accepted as it is asked for
    return packet(Buffer.concat([Buffer.from([0x32, 3, 0, 0, pdu[4], pdu[5], 0, 8, 0, 0, 0, 0]), pdu.subarray(10, 18)]));
  }
  // user data, group "time functions": 1 reads, 2 sets
  const subfunction = pdu[16];
  let data = Buffer.from([0x0a, 0, 0, 0]);
  if (subfunction === 2) {
    clock = Buffer.from(pdu.subarray(pdu.length - 10));
  } else {
    data = Buffer.concat([Buffer.from([0xff, 9, 0, 10]), clock]);
  }
  const parameters = Buffer.from([0, 1, 0x12, 8, 0x12, 0x87, subfunction, pdu[17], 0, 0, 0, 0]);
  const head = Buffer.from([0x32, 7, 0, 0, pdu[4], pdu[5], 0, parameters.length, 0, data.length]);
  return packet(Buffer.concat([head, parameters, data]));
}

const server = net.createServer((socket) => {
  let waiting = Buffer.alloc(0);
  socket.on("data", (octets) => {
    waiting = Buffer.concat([waiting, octets]);
    while (waiting.length >= 4 && waiting.length >= waiting.readUInt16BE(2)) {
      const size = waiting.readUInt16BE(2);
      socket.write(answer(waiting.subarray(0, size)));
      waiting = waiting.subarray(size);
    }
  });
});

const text = (time) => time.toISOString().slice(0, -1);

server.listen(0, "127.0.0.1", async () => {
  const plc = new S7Endpoint({ host: "127.0.0.1", port: server.address().port, rack: 0, slot: 2, autoReconnect: 0 });
  await plc.connect();
  const found = [];
  for (const [given, right] of [
    ["2026-11-29T14:05:09.123", "00202611291405091231"],
    ["2026-11-29T14:05:09.008", "00202611291405090081"],
  ]) {
    await plc.setTime(new Date(given + "Z"));
    const set = clock.toString("hex");
    clock = Buffer.from(right, "hex");
    const read = text(await plc.getTime());
    console.log(`setTime(${given}) sends ${set}, right is ${right}`);
    found.push([set, read === given]);
  }
  assert.deepEqual(found, [["00202611291405491200", true], ["00202611291405c90000", true]], "the behaviour has changed");
  process.exit(0);
});
JS
TZ=UTC timeout 60 node "$dir/try.js"
# output seen:
# setTime(2026-11-29T14:05:09.123) sends 00202611291405491200, right is 00202611291405091231
# setTime(2026-11-29T14:05:09.008) sends 00202611291405c90000, right is 00202611291405090081
