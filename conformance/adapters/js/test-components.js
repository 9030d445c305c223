// Checks of conformance/components: one function for each component, from a case to what came out of it, in the same
// form as the case has it. What throws a HapfError is compared with `error`.
import { Reader } from '../../../hapfmt/viewer/decoder/bytes.js';
import { decodeEvents, decodePacket, parseParameters } from '../../../hapfmt/viewer/decoder/codecs.js';
import { seedOf } from '../../../hapfmt/viewer/decoder/chunk.js';
import { crc32 } from '../../../hapfmt/viewer/decoder/crc32.js';
import { TrackDigest } from '../../../hapfmt/viewer/decoder/digest.js';
import { fillValues } from '../../../hapfmt/viewer/decoder/exact.js';
import { DeadbandGrid, UniformGrid } from '../../../hapfmt/viewer/decoder/grid.js';
import { clamp, floorDiv, floorDivBig, rdiv, rdivBig } from '../../../hapfmt/viewer/decoder/integers.js';
import { decodeIndices } from '../../../hapfmt/viewer/decoder/lpcr.js';
import { movePlace } from '../../../hapfmt/viewer/decoder/lpcx.js';
import { COSINES, Coefficients, cosine, decodeTransformed, readHeader, transformOf } from '../../../hapfmt/viewer/decoder/mdct.js';
import { Lattice, gainOf, noiseAt } from '../../../hapfmt/viewer/decoder/nois.js';
import { SINES, predictorOf } from '../../../hapfmt/viewer/decoder/predictor.js';
import { makeCode, readCodebook } from '../../../hapfmt/viewer/decoder/quan.js';
import { CONTEXTS, EVEN, EntropyDecoder, classEnds, learn, lengthEnds } from '../../../hapfmt/viewer/decoder/entropy.js';
import { hex, sha256 } from '../../../hapfmt/viewer/decoder/sha256.js';

const COUNT_BOUND = 2 ** 24; // of level 1
const WIDE = 2 ** 31;

export function bytesOf(text) {
  return Uint8Array.from(text.match(/../g) ?? [], (pair) => parseInt(pair, 16));
}

function bytesOfCase(c) {
  const bytes = bytesOf(c.packet);
  if (!c.then) return bytes;
  const more = new Uint8Array(c.then[1]).fill(parseInt(c.then[0], 16));
  return Uint8Array.of(...bytes, ...more);
}

function putVar(array, v) {
  for (; v >= 128; v = Math.floor(v / 128)) array.push((v % 128) + 128);
  array.push(v);
  return array;
}

// A track of level 1 that clamps nothing.
function trackOf(codec, parameters, { components = 1, numberFormat = 'counts', calibration = [1, 0, 1] } = {}) {
  const [A, B, D] = calibration.map(Number);
  const track = {
    id: 0, kind: 'full', codec, numberFormat, componentCount: components, countMin: -WIDE, countMax: WIDE - 1,
    level: 1, calibrations: Array(components).fill({ A, B, D }), contract: null, deviation: null,
  };
  track.setup = parseParameters(codec, Uint8Array.from(parameters), track);
  return track;
}

function columns(numbers, components) {
  return Array.from({ length: components }, (_, c) => Array.from(numbers).filter((_, i) => i % components === c));
}

const bits64 = (v) => BigInt(v).toString(16).padStart(16, '0');

function bitsOfNumber(v) {
  const view = new DataView(new ArrayBuffer(8));
  view.setFloat64(0, v);
  return bits64(view.getBigUint64(0));
}

function knots(c, parameters) {
  const track = trackOf('KNOT', parameters, c);
  const { numbers } = decodePacket(track, bytesOf(c.packet), 0, c.span);
  const counts = columns(numbers, c.components);
  const seen = c.knots?.filter(([tick]) => tick < c.span).map(([tick]) => [tick, counts.map((row) => row[tick])]);
  return { ...(c.counts && { counts }), ...(c.knots && { knots: seen.concat(c.knots.slice(seen.length)) }) };
}

const mdctParameters = ({ m, step, weights }) => [m, ...putVar([], step), weights.length, ...weights];

// v and x of blocks, by the transform as the decoder uses it.
function transformed(M, blocks) {
  const transform = transformOf(M);
  const rows = blocks.map((X) => transform.unfold(X, new Float64Array(M)));
  const v = rows.map((row) => [...row]);
  rows.forEach((row, n) => transform.mix(rows[n - 1] ?? null, row));
  transform.mix(rows[rows.length - 1], null);
  return { v, x: rows.flatMap((row) => [...row]) };
}

// What a decoder finds before the transform, block by block.
function integersOf(c, { size: M, steps }) {
  const bytes = bytesOf(c.packet);
  const reader = new Reader(bytes);
  const header = readHeader(reader, M, COUNT_BOUND);
  const coefficients = new Coefficients(header, steps, reader.bytes(reader.left), 0);
  coefficients.seen = [];
  const blocks = Array.from({ length: Math.ceil(c.span / M) }, () => {
    const X = new Float64Array(header.kept);
    coefficients.next(X);
    return [...X];
  });
  coefficients.finish();
  return { contexts: coefficients.seen, blocks };
}

const words = (ArrayType) => (rows) => ArrayType.from(rows, BigInt);
const DIGESTED = {
  counts: (rows) => Int32Array.from(rows),
  binary16: (rows) => Uint16Array.from(rows),
  binary32: (rows) => Uint32Array.from(rows),
  int64: words(BigUint64Array),
  uint64: words(BigUint64Array),
  binary64: words(BigUint64Array),
};

const INTERPOLATIONS = ['hold', 'linear'];

export const components = {
  varint(c) {
    const reader = new Reader(bytesOf(c.bytes), { start: c.at, requirement: 'CNV-002' });
    return { value: reader.varint(), stop: reader.position };
  },
  svarint(c) {
    const reader = new Reader(bytesOf(c.bytes), { start: c.at, requirement: 'CNV-002' });
    return { value: reader.svarint(), stop: reader.position };
  },
  division(c) {
    const [n, d] = [BigInt(c.n), BigInt(c.d)];
    const big = { floor: Number(floorDivBig(n, d)), rdiv: Number(rdivBig(n, d)) };
    if (2n * (n < 0n ? -n : n) + d >= 2n ** 53n) return big;
    const quick = { floor: floorDiv(Number(n), Number(d)), rdiv: rdiv(Number(n), Number(d)) };
    if (quick.floor !== big.floor || quick.rdiv !== big.rdiv) throw new Error('two quotients');
    return big;
  },
  clamp(c) {
    if (c.x !== undefined) return { result: clamp(c.x, c.low, c.high) };
    return { sum: clamp(clamp(c.lf, ...c.lf_range) + clamp(c.hf, ...c.hf_range), ...c.lf_range) };
  },
  crc32(c) {
    return { crc: crc32(bytesOf(c.bytes)) };
  },
  'file-crc'(c) {
    const bytes = bytesOf(c.bytes);
    return { crc: crc32(bytes, 0, bytes.length, seedOf(c.file_id)) };
  },
  classes(c) {
    const rows = (number) => Array.from({ length: CONTEXTS }, (_, i) => [...classEnds(number).subarray(16 * i, 16 * i + 16)]);
    if (c.class !== undefined) return { ends: rows(c.class) };
    const all = Uint16Array.from(Array.from({ length: 16 }, (_, number) => rows(number)).flat(2));
    return { sha256: hex(sha256(new Uint8Array(all.buffer))) };
  },
  lengths(c) {
    return { ends: [...lengthEnds(c.weights)] };
  },
  models(c) {
    if (c.bits) {
      let model = EVEN;
      return { p: c.bits.map((bit) => (model = learn(model, bit, c.limit)) >>> 8) };
    }
    let values;
    const after = Array.from({ length: c.values.length + 1 }, (_, count) => {
      const coder = new EntropyDecoder(bytesOf(c.coded), 0, 1);
      values = new Float64Array(count);
      coder.byBits(count, c.signs, values);
      if (count === c.values.length) coder.finish();
      return [coder.states[0], coder.front, coder.rawBits];
    });
    return { after, values: [...values] };
  },
  'entropy-coder'(c) {
    const coder = new EntropyDecoder(bytesOf(c.coded), 0, c.states);
    const after = [];
    const sections = c.sections.map((section) => {
      const { kind, p } = section;
      const count = section.values.length;
      let out = new Float64Array(kind === 'bits' ? count + 1 : count);
      if (kind === 'signs') out = out.map((_, i) => Math.abs(section.values[i]));
      if (kind === 'bits') coder.repeats(count + 1, p, out);
      else if (kind === 'signs') coder.signs(count, p, out);
      else if (kind === 'lengths') coder.wide(count, { first: section.first, ends: lengthEnds(section.weights) }, out, []);
      else if (kind.startsWith('by bits')) coder.byBits(count, kind === 'by bits', out);
      else coder.integers(count, section.class, section.start, kind === 'class', out);
      after.push([...coder.states, coder.front, coder.rawBits]);
      return { ...section, values: [...(kind === 'bits' ? out.subarray(1) : out)] };
    });
    coder.finish();
    return { after, sections };
  },
  knot(c) {
    return knots(c, putVar([INTERPOLATIONS.indexOf(c.interpolation), 0, 0], c.step).concat(0));
  },
  'coded-knots'(c) {
    return knots(c, [INTERPOLATIONS.indexOf(c.interpolation), 1, 0, 1, 0]);
  },
  codebook(c) {
    const { direct_levels: M, run_classes: R, escape_classes: C } = c;
    const lengths = readCodebook(bytesOf(c.codebook), 2 * M + R + C + 1);
    const { bits, table } = makeCode(lengths);
    const words = {};
    lengths.forEach((length, symbol) => {
      if (length === 0) return;
      const at = table.findIndex((entry) => entry >> 4 === symbol);
      words[symbol] = bits === 0 ? '' : at.toString(2).padStart(bits, '0').slice(0, length);
    });
    return { lengths: [...lengths], words };
  },
  quan(c) {
    const { direct_levels: M, run_classes: R, escape_classes: C, step } = c;
    const parameters = [step & 255, (step >> 8) & 255, (step >> 16) & 255, step >>> 24, M & 255, M >> 8, R, C];
    const track = trackOf('QUAN', [...parameters, ...bytesOf(c.codebook)]);
    const counts = [...decodePacket(track, bytesOf(c.packet), 0, c.total).numbers];
    return { counts, levels: counts.map((count) => count / step) };
  },
  rawb(c) {
    const numberFormat = c.signed ? 'counts' : { 2: 'binary16', 4: 'binary32', 8: 'uint64' }[c.word_size];
    const track = trackOf('RAWB', [c.word_size, 0, 0, 0], { ...c, numberFormat });
    const { numbers } = decodePacket(track, bytesOf(c.packet), 0, c.span);
    return { numbers: columns(numbers, c.components) };
  },
  evnt(c) {
    const events = decodeEvents({}, bytesOfCase(c), c.start, c.span)
      .map(({ tick, duration, channel, text }) => [tick, duration, channel, text]);
    return { events, count: events.length, text_size: new TextEncoder().encode(events[0][3]).length };
  },
  sine(c) {
    if (c.pairs) return { pairs: c.pairs.map(([k]) => [k, k < 0 ? -SINES[-k] : SINES[k]]) };
    const bytes = new Uint8Array(256);
    SINES.forEach((v, i) => bytes.set([v & 255, v >> 8], 2 * i));
    return { sha256: hex(sha256(bytes)), entries: [...SINES] };
  },
  predictor(c) {
    return { c: [...predictorOf(c.k)] };
  },
  grid(c) {
    const bound = c.bound ?? COUNT_BOUND;
    const grid = c.grid === 0 ? new UniformGrid(c.step, c.zero, bound)
      : new DeadbandGrid(c.step, c.zero, c.kn, c.kd, bound);
    const result = { last: grid.highest };
    if (c.indices) result.counts = c.indices.map((index) => grid.count(index));
    if (c.grid === 0) return result;
    const { levels } = grid;
    if (c.first_levels) result.first_levels = [...levels.subarray(0, c.first_levels.length)];
    if (c.levels) result.levels = [...levels];
    result.sha256 = hex(sha256(new Uint8Array(BigInt64Array.from(levels, BigInt).buffer)));
    return result;
  },
  lpcr(c) {
    const indices = [];
    decodeIndices({ highest: c.last }, c.components, bytesOf(c.packet), c.span, 0, (component, index) => {
      indices.push([...index]);
    });
    return { indices };
  },
  cosine(c) {
    if (c.pairs) return { pairs: c.pairs.map(([i]) => [i, cosine(i)]) };
    return { sha256: hex(sha256(new Uint8Array(Uint16Array.from(COSINES).buffer))), entries: [...COSINES] };
  },
  'mdct-steps'(c) {
    return { steps: [...trackOf('MDCT', mdctParameters(c)).setup.steps] };
  },
  transform(c) {
    const { v, x } = transformed(2 ** c.m, c.coefficients);
    return { v, x };
  },
  mdct(c) {
    const { setup } = trackOf('MDCT', mdctParameters(c), c);
    const counts = Array.from({ length: c.components }, () => []);
    decodeTransformed(setup, c.components, bytesOf(c.packet), c.span, COUNT_BOUND, 0, (component, at, row, base) => {
      for (let t = 0; t < row.length && at + t < c.span; t++) counts[component][at + t] = base + row[t];
    });
    return { counts, ...(c.contexts && integersOf(c, setup)) };
  },
  digest(c) {
    const digest = new TrackDigest();
    for (const { start, rows } of c.packets) {
      digest.add(start, rows.length, { numbers: DIGESTED[c.number_format](rows.flat()), exact: null });
    }
    return { spans: digest.spans, of_numbers: hex(digest.numbers.digest()), digest: hex(digest.value()) };
  },
  noise(c) {
    return { n: c.n.map((_, i) => noiseAt(c.seed, c.first + i, c.density)) };
  },
  'noise-gains'(c) {
    const values = c.values.map((_, q) => gainOf(q));
    return { values, sha256: hex(sha256(new Uint8Array(BigInt64Array.from(values, BigInt).buffer))) };
  },
  lattice(c) {
    const filter = new Lattice(c.k.length);
    filter.set(c.k);
    const states = [];
    const counts = c.e.map((e) => {
      const count = rdiv(filter.next(e), 64);
      states.push([...filter.g]);
      return count;
    });
    return { counts, g: [...states.slice(0, 4), ...states.slice(-1)] };
  },
  nois(c) {
    const track = trackOf('NOIS', [c.shift, c.intervals], c);
    return { counts: columns(decodePacket(track, bytesOf(c.packet), 0, c.span).numbers, c.components) };
  },
  'exact-values'(c) {
    const [A, B, D] = c.calibration.map(Number);
    const coefficients = c.coefficients && [...new Float64Array(BigUint64Array.from(c.coefficients, (hex) => BigInt(`0x${hex}`)).buffer)];
    const values = new Float64Array(c.counts.length);
    const placed = { distinct: c.counts, places: c.counts.map((_, i) => i) };
    fillValues({ rule: c.rule, digits: c.digits, coefficients }, { A, B, D }, c.counts, placed, values);
    return { values: [...values].map(bitsOfNumber) };
  },
  places(c) {
    const halves = new Int32Array(BigUint64Array.of(BigInt(`0x${c.bits}`)).buffer);
    const correction = new Int32Array(BigInt64Array.of(BigInt.asIntN(64, BigInt(c.correction ?? 0))).buffer);
    movePlace(halves, 0, correction[0], correction[1], 0);
    return { exact: bits64(new BigUint64Array(halves.buffer)[0]) };
  },
  lpcx(c) {
    const track = trackOf('LPCX', [c.rule, c.digits, 0, 0], c);
    if (c.range) [track.countMin, track.countMax] = c.range;
    if (c.counts) {
      const { numbers } = decodePacket(track, bytesOf(c.packet), 0, c.span);
      if (String(numbers) !== String(c.counts)) return { counts: [...numbers] };
    }
    const { numbers, exact } = decodePacket(track, bytesOf(c.packet), 0, c.span, { exact: true });
    return { counts: [...numbers], exact: [...exact].map(bits64) };
  },
};
