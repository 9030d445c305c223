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

const packetsOf = new Map(); // codec -> packets
for (const packet of file.packets) {
  const track = file.tracks.get(packet.track);
  if (!track.setup || track.unsupported || track.kind === 'events') continue;
  if (!packetsOf.has(track.codec)) packetsOf.set(track.codec, []);
  packetsOf.get(track.codec).push({ ...packet, track });
}

function decodeAll(packets) {
  let samples = 0;
  for (const { track, bytes: packet, start, span } of packets) {
    decodePacket(track, packet, start, span, { exact: true });
    samples += span * track.componentCount;
  }
  return samples;
}

function measure(name, packets) {
  decodeAll(packets); // warm
  let samples = 0;
  let spent = 0;
  while (spent < 1000 * Number(seconds)) {
    const start = performance.now();
    samples += decodeAll(packets);
    spent += performance.now() - start;
  }
  console.log(`${name.padEnd(8)} ${(samples / spent / 1000).toFixed(2)} million samples per second`);
}

for (const [codec, packets] of packetsOf) measure(codec, packets);
if (packetsOf.size > 1) measure('all', [...packetsOf.values()].flat());
