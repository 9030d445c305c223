// Answers requests, one JSON object a line, by the data layer of the viewer. Arrays are base64 of their bytes.
import { readFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { openRecording } from '../../hapfmt/viewer/data/client.js';
import { Thread } from '../../hapfmt/viewer/data/thread.js';

let recording = null;
let changes = [];

function sourceOf({ kind, place }) {
  if (kind === 'url') return { name: 'recording', url: place };
  const bytes = new Uint8Array(readFileSync(place));
  return { name: 'recording', ...(kind === 'blob' ? { blob: new Blob([bytes]) } : { bytes }) };
}

const CALLS = {
  async open(source) {
    recording?.close();
    changes = [];
    recording = await openRecording(sourceOf(source), { worker: () => new Thread(), onChange: (what) => changes.push(what) });
    return CALLS.facts();
  },
  facts() {
    const { link, origin, ...facts } = recording;
    return { ...facts, changes };
  },
  // An envelope once nothing of it is missing.
  async settled(args) {
    for (;;) {
      const found = await recording.envelope(...args);
      if (Object.values(found).every(({ complete }) => complete)) return found;
      await new Promise((resolve) => { setTimeout(resolve, 5); });
    }
  },
  async dropped(args) {
    const control = new AbortController();
    const found = recording.samples(...args, { signal: control.signal }).then(() => 'answered', ({ name }) => name);
    control.abort();
    return found;
  },
};

const packed = (_, value) => (ArrayBuffer.isView(value)
  ? { base64: Buffer.from(value.buffer, value.byteOffset, value.byteLength).toString('base64'), type: value.constructor.name } : value);

for await (const line of createInterface({ input: process.stdin })) {
  const { call, args } = JSON.parse(line);
  let answer;
  try {
    const value = call in CALLS ? await CALLS[call](args) : await recording[call](...args);
    answer = { value };
  } catch (error) {
    const { name, message, requirement = null, kind = null } = error;
    answer = { error: { name, message, requirement, kind, stack: error.stack } };
  }
  process.stdout.write(`${JSON.stringify(answer, packed)}\n`);
}
