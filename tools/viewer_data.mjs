// node viewer_data.mjs FILE: what the data layer of the viewer needs for FILE behind a URL, as JSON.
import { closeSync, fstatSync, openSync, readSync } from 'node:fs';
import { createServer } from 'node:http';
import { openRecording } from '../hapfmt/viewer/data/client.js';
import { Thread } from '../hapfmt/viewer/data/thread.js';

const BINS = 1500; // of a screen

const handle = openSync(process.argv[2]);
const { size } = fstatSync(handle);

function answer(request, response) {
  const [, from, to] = /^bytes=(\d*)-(\d*)$/.exec(request.headers.range);
  const start = from === '' ? Math.max(size - Number(to), 0) : Number(from);
  const stop = from === '' ? size : Math.min(Number(to) + 1, size);
  const bytes = Buffer.alloc(stop - start);
  readSync(handle, bytes, 0, bytes.length, start);
  response.writeHead(206, { 'content-range': `bytes ${start}-${stop - 1}/${size}`, 'content-length': bytes.length });
  response.end(bytes);
}

const server = createServer(answer);
await new Promise((resolve) => { server.listen(0, '127.0.0.1', resolve); });
const url = `http://127.0.0.1:${server.address().port}/recording`;

const steps = [];
let recording = null;

// Time, requests, bytes and decoded samples of one step.
async function step(name, action) {
  const before = recording ? await recording.stats() : { requests: 0, bytesFetched: 0, samplesDecoded: 0, decodeMs: 0 };
  const began = performance.now();
  await action();
  const ms = performance.now() - began;
  const after = await recording.stats();
  const spent = Object.fromEntries(Object.keys(after).map((key) => [key, after[key] - before[key]]));
  steps.push({ name, ms, ...spent });
}

const open = async () => {
  recording?.close();
  recording = await openRecording({ name: 'recording', url }, { worker: () => new Thread() });
};
const whole = () => recording.envelope(recording.channels.map(({ index }) => index), recording.start, recording.stop, BINS);

await step('open', open);
await step('first picture of all channels', whole);
await step('the same, complete', async () => {
  for (;;) {
    const found = await whole();
    if (Object.values(found).every(({ complete }) => complete)) break;
    await new Promise((resolve) => { setTimeout(resolve, 120); });
  }
});
const memory = process.memoryUsage();
await step('once more', whole);
recording.close();
recording = null;
await step('open', open);
const middle = Math.floor((recording.start + recording.stop) / 2);
await step('1 s of one channel', () => recording.samples(0, middle, middle + 1));
await step('1 s of all channels', () => recording.envelope(recording.channels.map(({ index }) => index), middle, middle + 1, BINS));
recording.close();
server.closeAllConnections();
server.close();
closeSync(handle);
process.stdout.write(JSON.stringify({ size, steps, memory: memory.heapUsed + memory.arrayBuffers }));
