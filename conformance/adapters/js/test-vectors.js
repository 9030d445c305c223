// Checks of conformance/vectors: the verdict on a file and what it decodes to, compared with conformance/expected.
import { decodeFile } from '../../../hapfmt/viewer/decoder/decode.js';
import { HapfError } from '../../../hapfmt/viewer/decoder/error.js';
import { openFile } from '../../../hapfmt/viewer/decoder/file.js';
import { decodeOutput } from './output.js';
import { EXIT_CODES } from '../../../hapfmt/viewer/decoder/report.js';
import { Sha256, hex } from '../../../hapfmt/viewer/decoder/sha256.js';
import { verifyFile } from '../../../hapfmt/viewer/decoder/verify.js';

function rawOf(chunks) {
  const digest = new Sha256();
  let size = 0;
  for (const bytes of chunks) {
    digest.update(bytes);
    size += bytes.length;
  }
  return { count: size / 8, sha256: hex(digest.digest()) };
}

// The places where `got` differs from `want`: objects by the members of `want`, lists as a whole.
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
  return want === got ? [] : [`${place}: ${JSON.stringify(got)} instead of ${JSON.stringify(want)}`];
}

function checkVerdict(bytes, want) {
  const file = verifyFile(bytes);
  const { verdict, findings, damages } = file;
  const problems = [];
  if (want.verdict && ![want.verdict].flat().includes(verdict)) problems.push(`${verdict} instead of ${want.verdict}`);
  const rules = new Set([...findings, ...damages].map(({ requirement }) => requirement));
  const wanted = [want.verify?.requirement ?? []].flat();
  if (wanted.length > 0 && !wanted.some((id) => rules.has(id))) problems.push(`${[...rules]} instead of ${wanted}`);
  return { verdict, problems };
}

export function checkFile(bytes, want) {
  try {
    const { verdict, problems } = checkVerdict(bytes, want);
    const code = EXIT_CODES[verdict];
    const codes = [want.exit?.verify ?? code].flat();
    if (!codes.includes(code)) problems.push(`exit code ${code} instead of ${codes}`);
    const file = openFile(bytes);
    // What is refused, or not understood, need not be delivered; nor what breaks a rule.
    if (!want.decode || code === 4 || code === 2 || file.refused) return problems;
    const decoded = decodeFile(file);
    const { json, raw } = decodeOutput(file, decoded);
    const again = new Map([...raw].map(([name]) => [name, () => decodeOutput(file, decoded).raw.get(name)]));
    return [...problems, ...differences(want.decode, JSON.parse(json), again, 'decode')];
  } catch (error) {
    if (error instanceof HapfError) return [`refused: ${error.requirement} ${error.message}`];
    return [error.stack];
  }
}
