// Calls one exported function of a module of the page: { module, code, input } on stdin. `code` gets the module and the
// input; arrays of numbers that JSON cannot hold come as texts.
import { readFileSync } from 'node:fs';

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
const run = new Function('m', 'input', `return (async () => { ${code} })()`);
process.stdout.write(JSON.stringify({ value: await run(loaded, input) ?? null }, replace));
