// Runs the component vectors and the files: node test.js [name ...]. Exit code 1 where one fails.
import { existsSync, readFileSync, readdirSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import { HapfError } from '../../../hapfmt/viewer/decoder/error.js';
import { components as codecs } from './test-components.js';
import { containers } from './test-container.js';
import { compareQuick } from './test-quick.js';
import { checkFile } from './test-vectors.js';

const CONFORMANCE = fileURLToPath(new URL('../../', import.meta.url));
const components = { ...codecs, ...containers };
const wanted = process.argv.slice(2);

function textOf(value) {
  return JSON.stringify(value, (_, v) => (typeof v === 'bigint' ? String(v) : v));
}

// Numbers beyond 2^53 are text in the vectors.
const sameValue = (a, b) => textOf(a) === textOf(b) || textOf(a).replaceAll('"', '') === textOf(b).replaceAll('"', '');

function checkCase(name, c) {
  let result;
  try {
    result = components[name](c);
  } catch (error) {
    if (!(error instanceof HapfError)) return `${error.stack}`;
    const allowed = [c.error ?? []].flat();
    return [error.requirement, ...error.also].some((id) => allowed.includes(id)) ? null
      : `${error.requirement} (${error.message}) instead of ${allowed.join(' or ') || 'a result'}`;
  }
  if (c.error) return `nothing instead of ${c.error}`;
  const want = c;
  for (const [member, value] of Object.entries(result)) {
    if (want[member] !== undefined && !sameValue(value, want[member])) {
      return `${member}: ${textOf(value).slice(0, 200)} instead of ${textOf(want[member]).slice(0, 200)}`;
    }
  }
  return null;
}

let failures = 0;
const folder = `${CONFORMANCE}components`;
for (const file of existsSync(folder) ? readdirSync(folder).sort() : []) {
  if (!file.endsWith('.json')) continue;
  const { component, cases } = JSON.parse(readFileSync(`${folder}/${file}`));
  if (wanted.length > 0 && !wanted.includes(component)) continue;
  if (!components[component]) {
    console.log(`${component}: ${cases.length} not tried`);
    continue;
  }
  let passed = 0;
  for (const c of cases) {
    const problem = checkCase(component, c);
    if (problem === null) passed++;
    else console.log(`  ${component}, ${c.name}: ${problem}`);
  }
  failures += cases.length - passed;
  console.log(`${component}: ${passed} of ${cases.length}`);
}

for (const set of existsSync(`${CONFORMANCE}expected`) ? readdirSync(`${CONFORMANCE}expected`).sort() : []) {
  if (wanted.length > 0 && !wanted.includes(set)) continue;
  let passed = 0;
  let tried = 0;
  for (const name of readdirSync(`${CONFORMANCE}expected/${set}`).sort()) {
    const file = `${CONFORMANCE}vectors/${set}/${name.replace(/\.json$/, '.hapf')}`;
    if (!existsSync(file)) continue;
    tried++;
    const problems = checkFile(new Uint8Array(readFileSync(file)), JSON.parse(readFileSync(`${CONFORMANCE}expected/${set}/${name}`)));
    if (problems.length === 0) passed++;
    else console.log(`  ${set}/${name}: ${problems[0].slice(0, 300)}`);
  }
  failures += tried - passed;
  console.log(`${set}: ${passed} of ${tried}`);
}
if (wanted.length === 0 || wanted.includes('quick')) {
  for (const [name, [agreed, cases]] of compareQuick()) {
    failures += cases - agreed;
    console.log(`${name}: ${agreed} of ${cases}`);
  }
}
process.exitCode = failures > 0 ? 1 : 0;
