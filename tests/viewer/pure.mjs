// Runs code with a module of the viewer: each line of stdin is { module, code, input }, and gets a line with { value } or
// { error }. `code` gets the module as m, the input, and open(path), which gives a recording. Numbers that JSON cannot
// hold come as texts.
import { readFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { openRecording } from '../../hapfmt/viewer/data/client.js';
import { Thread } from '../../hapfmt/viewer/data/thread.js';

const special = { NaN, Infinity, '-Infinity': -Infinity };
const revive = (_, value) => (typeof value === 'string' && value in special ? special[value] : value);
const replace = (_, value) => {
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (typeof value === 'bigint') return String(value);
  if (Object.is(value, -0)) return '-0';
  return typeof value === 'number' && !Number.isFinite(value) ? String(value) : value;
};

const open = (path) => openRecording({ name: path, bytes: new Uint8Array(readFileSync(path)) }, { worker: () => new Thread() });
const told = async (line) => {
  try {
    const { module, code, input } = JSON.parse(line, revive);
    const loaded = await import(`../../hapfmt/viewer/${module}`);
    const run = new Function('m', 'input', 'open', `return (async () => { ${code} })()`);
    return { value: (await run(loaded, input, open)) ?? null };
  } catch (error) {
    return { error: String(error?.stack ?? error) };
  }
};

for await (const line of createInterface({ input: process.stdin })) {
  process.stdout.write(`${JSON.stringify(await told(line), replace)}\n`);
}
process.exit(0); // threads may be there still
