// Decoding speed: node bench.js FILE [seconds] prints samples per second, of all tracks and of each codec.
import { readFileSync } from 'node:fs';
import { decodePacket } from '../../../hapfmt/viewer/decoder/codecs.js';
import { openFile } from '../../../hapfmt/viewer/decoder/file.js';

const [path, seconds = '2'] = process.argv.slice(2);
if (path === undefined) {
  console.error('usage: node bench.js FILE [seconds]');
  process.exit(1);
}
const bytes = new Uint8Array(readFileSync(path));
const began = performance.now();
const file = openFile(bytes);
console.log(`opened in ${(performance.now() - began).toFixed(1)} ms, ${bytes.length} bytes`);

const ROUND = 20; // milliseconds
const packetsOf = new Map(); // codec -> packets
for (const packet of file.packets) {
  const track = file.tracks.get(packet.track);
  if (!track.setup || track.unsupported || track.kind === 'events') continue;
  if (!packetsOf.has(track.codec)) packetsOf.set(track.codec, []);
  packetsOf.get(track.codec).push({ ...packet, track });
}

function decodeAll(packets, exact) {
  let samples = 0;
  for (const { track, bytes: packet, start, span } of packets) {
    decodePacket(track, packet, start, span, { exact });
    samples += span * track.componentCount;
  }
  return samples;
}

// The best of many rounds, in CPU time: other programs may run on the machine.
function measure(name, packets, exact) {
  let best = 0;
  const spent = () => { // milliseconds
    const { user, system } = process.cpuUsage();
    return (user + system) / 1000;
  };
  for (const end = spent() + 1000 * Number(seconds); spent() < end;) {
    let samples = 0;
    const start = spent();
    do samples += decodeAll(packets, exact); while (spent() - start < ROUND);
    best = Math.max(best, samples / (spent() - start));
  }
  console.log(`${name.padEnd(12)} ${(best / 1000).toFixed(2)} million samples per second`);
}

for (const [codec, packets] of packetsOf) {
  measure(codec, packets, true);
  if (codec === 'LPCX') measure('LPCX counts', packets, false);
}
if (packetsOf.size > 1) measure('all', [...packetsOf.values()].flat(), true);
