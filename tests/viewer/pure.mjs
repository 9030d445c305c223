// Runs code with a module of the viewer: { module, code, input } on stdin. `code` gets the module as m, the input, and
// open(path), which gives a recording. Numbers that JSON cannot hold come as texts.
import { readFileSync } from 'node:fs';
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

const { module, code, input } = JSON.parse(readFileSync(0, 'utf8'), revive);
const loaded = await import(`../../hapfmt/viewer/${module}`);
const open = (path) => openRecording({ name: path, bytes: new Uint8Array(readFileSync(path)) }, { worker: () => new Thread() });
const run = new Function('m', 'input', 'open', `return (async () => { ${code} })()`);
process.stdout.write(JSON.stringify({ value: await run(loaded, input, open) ?? null }, replace));
