// Checks of conformance/vectors: what a file decodes to, compared with conformance/expected.
import { decodeFile } from './decode.js';
import { HapfError } from './error.js';
import { openFile } from './file.js';
import { decodeOutput } from './output.js';
import { Sha256, hex } from './sha256.js';

function rawOf(chunks) {
  const digest = new Sha256();
  let size = 0;
  for (const bytes of chunks) {
    digest.update(bytes);
    size += bytes.length;
  }
  return { count: size / 8, sha256: hex(digest.digest()) };
}

// The places where `got` has not what is wanted: objects by the members that are wanted, lists as a whole.
function differences(want, got, raw, place) {
  if (want !== null && typeof want === 'object' && want.sha256 !== undefined && typeof got === 'string') {
    const { count, sha256 } = rawOf(raw.get(got)());
    return count === want.count && sha256 === want.sha256 ? []
      : [`${place}: ${count} numbers ${sha256.slice(0, 8)} instead of ${want.count} ${JSON.stringify(want.numbers)}`];
  }
  if (Array.isArray(want)) {
    if (!Array.isArray(got) || got.length !== want.length) return [`${place}: ${JSON.stringify(got)} instead of ${JSON.stringify(want)}`];
    return want.flatMap((value, i) => differences(value, got[i], raw, `${place}[${i}]`));
  }
  if (want !== null && typeof want === 'object') {
    if (got === null || typeof got !== 'object') return [`${place}: ${JSON.stringify(got)} instead of an object`];
    return Object.entries(want).flatMap(([name, value]) => differences(value, got[name], raw, `${place}.${name}`));
  }
  return Object.is(want, got) ? [] : [`${place}: ${JSON.stringify(got)} instead of ${JSON.stringify(want)}`];
}

export function checkDecode(bytes, want) {
  let file;
  try {
    file = openFile(bytes);
    const decoded = decodeFile(file);
    const { json, raw } = decodeOutput(file, decoded);
    const again = new Map([...raw].map(([name]) => [name, () => decodeOutput(file, decoded).raw.get(name)]));
    return want.decode ? differences(want.decode, JSON.parse(json), again, 'decode') : [];
  } catch (error) {
    if (error instanceof HapfError) return [`refused: ${error.requirement} ${error.message}`];
    return [error.stack];
  }
}
