// The promises of a file against its source (clause 11, TLV-006), in exact arithmetic (DBC-002).
import { channelsOf } from './channels.js';
import { decodeFile } from './decode.js';

const abs = (v) => (v < 0n ? -v : v);
const view = new DataView(new ArrayBuffer(8));

// A finite binary64 number as n / d, both BigInts, d a power of two.
function fractionOf(bits) {
  const exponent = Number((bits >> 52n) & 2047n);
  const fraction = bits & (2n ** 52n - 1n);
  if (exponent === 2047) return null;
  const magnitude = exponent === 0 ? fraction : fraction | (2n ** 52n);
  const shift = Math.max(exponent, 1) - 1075;
  const signed = bits >> 63n ? -magnitude : magnitude;
  return shift >= 0 ? [signed << BigInt(shift), 1n] : [signed, 1n << BigInt(-shift)];
}

const bitsOf = (number) => {
  view.setFloat64(0, number);
  return view.getBigUint64(0);
};

// The number of a word as a fraction, null for NaN and infinity.
function valueOf(format, word) {
  if (format === 'int64') return [BigInt.asIntN(64, word), 1n];
  if (format === 'uint64') return [word, 1n];
  if (format === 'binary64') return fractionOf(word);
  if (format === 'binary32') {
    view.setUint32(0, Number(word));
    return fractionOf(bitsOf(view.getFloat32(0)));
  }
  const w = Number(word);
  const [e, f] = [(w >> 10) & 31, w & 1023];
  if (e === 31) return null;
  return fractionOf(bitsOf((w & 0x8000 ? -1 : 1) * (e === 0 ? f * 2 ** -24 : (f + 1024) * 2 ** (e - 25))));
}

// The count nearest to a source value, ties upwards.
function nearestCount([n, d], { A, B, D }) {
  let above = n * BigInt(D) - BigInt(B) * d;
  let below = BigInt(A) * d;
  if (below < 0n) [above, below] = [-above, -below];
  const doubled = 2n * above + below;
  const q = doubled / (2n * below);
  return doubled < 0n && q * 2n * below !== doubled ? q - 1n : q;
}

// Every tick that the source or the file has: calls each(tick, x index or -1, y index or -1).
function eachTick(source, delivered, each) {
  const cursor = (spans) => {
    let [i, tick, index] = [0, spans.length ? spans[0][0] : Infinity, 0];
    return {
      get tick() { return tick; },
      get index() { return index; },
      next() {
        index++;
        tick++;
        if (tick >= spans[i][1]) tick = ++i < spans.length ? spans[i][0] : Infinity;
      },
    };
  };
  const filled = (spans) => cursor(spans.filter(([start, stop]) => stop > start));
  const [x, y] = [filled(source), filled(delivered)];
  while (x.tick < Infinity || y.tick < Infinity) {
    const tick = Math.min(x.tick, y.tick);
    each(tick, x.tick === tick ? x.index : -1, y.tick === tick ? y.index : -1);
    if (x.tick === tick) x.next();
    if (y.tick === tick) y.next();
  }
}

function channelNumbers(channel, exact) {
  const lists = channel.parts.map((part) => (exact ? part.exact() : part.numbers()));
  const length = lists.reduce((sum, list) => sum + list.length, 0);
  return { length, at: (i) => {
    let left = i;
    for (const list of lists) {
      if (left < list.length) return BigInt(list[left]);
      left -= list.length;
    }
    return 0n;
  } };
}

// job: the JSON of `encode`; sources: the raw words of each channel, BigUint64Array. -> the list `contracts`.
export function checkContracts(file, job, sources) {
  const decoded = decodeFile(file, { exact: true });
  const { channels } = channelsOf(file, decoded);
  const residuals = new Map([...file.tracks.values()].filter((t) => t.kind === 'hf').map((t) => [t.base, t]));
  const compared = job.channels.map((source, number) => {
    const channel = channels.find((one) => one.channel === number);
    return { source, words: sources[number], channel, number };
  });
  return compared.map((one) => checkChannel(one, compared, residuals));
}

// The source's count of a sample, and what differs where there is no contract.
function countOf({ source, words, channel }, i) {
  if (source.format === 'counts') return BigInt.asIntN(64, words[i]);
  const value = valueOf(source.format, words[i]);
  return value && nearestCount(value, channel.track.calibrations[channel.component]);
}

function checkChannel(one, compared, residuals) {
  const { source, words, channel, number } = one;
  const result = { channel: number, outside: 0, worst: 0, promised: true, requirement: 'DBC-004' };
  if (!channel) return { ...result, outside: source.spans.reduce((sum, [start, stop]) => sum + stop - start, 0), worst: null };
  const { track } = channel;
  const contract = (residuals.get(track.id) ?? track).contract;
  if (contract) {
    Object.assign(result, { promised: contract.guaranteed, requirement: 'DBC-002' });
    if (contract.vector) checkVector(one, compared, contract, result);
    else checkScalar(one, contract, result);
    return result;
  }
  const exact = channel.parts.length > 0 && channel.parts.every((part) => part.isExact);
  const y = channelNumbers(channel, exact && source.format === 'binary64');
  const tolerance = track.deviations?.[channel.component];
  const same = sameness(source, track, channel, exact, tolerance);
  eachTick(source.spans, channel.spans, (tick, i, j) => {
    if (i < 0 || j < 0 || !same(words[i], y.at(j))) result.outside++;
  });
  if (tolerance && (tolerance.declared || tolerance.largest)) result.requirement = 'TLV-006';
  if (result.outside) result.worst = null;
  return result;
}

// DBC-004: counts, words or exact values; TLV-006 where the source was put on a quantisation grid.
function sameness(source, track, channel, exact, tolerance) {
  if (source.format === 'counts') return (x, y) => BigInt.asIntN(64, x) === y;
  if (track.numberFormat === source.format || (exact && source.format === 'binary64')) return (x, y) => x === y;
  const { A, B, D } = channel.track.calibrations[channel.component];
  const [largest, scale] = fractionOf(bitsOf(tolerance?.largest ?? 0));
  return (x, y) => {
    const value = valueOf(source.format, x);
    if (!value) return false;
    const [n, d] = value;
    // |n / d - (y * A + B) / D| <= largest / scale
    const distance = abs(n * BigInt(D) - (y * BigInt(A) + BigInt(B)) * d);
    return distance * scale <= largest * d * BigInt(D);
  };
}

function ratio(left, right) {
  if (left === 0n) return 0;
  // 53 bits of the quotient are enough to tell.
  return Number((left << 60n) / right) / 2 ** 60;
}

function checkScalar(one, contract, result) {
  const { source, channel } = one;
  const y = channelNumbers(channel, false);
  const kd = BigInt(contract.kd);
  const kn = BigInt(contract.kn);
  const least = BigInt(contract.floors[channel.component]) * kd;
  const zero = BigInt(contract.zeros[channel.component]);
  let worst = [0n, 1n];
  eachTick(source.spans, channel.spans, (tick, i, j) => {
    const x = i < 0 || j < 0 ? null : countOf(one, i);
    if (x === null) {
      result.outside++;
      return;
    }
    const left = abs(x - y.at(j)) * kd;
    const wide = kn * abs(x - zero);
    const right = wide > least ? wide : least;
    if (left > right) result.outside++;
    if (left * worst[1] > worst[0] * right) worst = [left, right];
  });
  result.worst = ratio(...worst);
}

// All components of the track at once, by their squares.
function checkVector(one, compared, contract, result) {
  const { track } = one.channel;
  const parts = track.channels.map((number) => compared.find((other) => other.number === number));
  if (parts.some((part) => !part?.channel)) return;
  const lists = parts.map((part) => channelNumbers(part.channel, false));
  const kd2 = BigInt(contract.kd) ** 2n;
  const kn2 = BigInt(contract.kn) ** 2n;
  const least = BigInt(contract.floors[0]) ** 2n * kd2;
  let worst = [0n, 1n];
  eachTick(one.source.spans, one.channel.spans, (tick, i, j) => {
    const xs = i < 0 || j < 0 ? [null] : parts.map((part) => countOf(part, i));
    if (xs.includes(null)) {
      result.outside++;
      return;
    }
    let far = 0n;
    let size = 0n;
    xs.forEach((x, c) => {
      far += (x - lists[c].at(j)) ** 2n;
      size += (x - BigInt(contract.zeros[c])) ** 2n;
    });
    const left = far * kd2;
    const wide = kn2 * size;
    const right = wide > least ? wide : least;
    if (left > right) result.outside++;
    if (left * worst[1] > worst[0] * right) worst = [left, right];
  });
  result.worst = Math.sqrt(ratio(...worst));
}
