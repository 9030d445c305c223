// Seconds and ticks (clause 7).
import { firstTick } from '../decoder/times.js';

const TICK_BOUND = 2 ** 48;

// A Number stands for its shortest decimal: 0.1 is one tenth. -> [n, d], BigInts.
function exact(seconds) {
  const [, sign, whole, fraction = '', exponent = '0'] = /^(-?)(\d+)(?:\.(\d+))?(?:e([+-]\d+))?$/.exec(String(seconds));
  const scale = Number(exponent) - fraction.length;
  const n = BigInt(sign + whole + fraction);
  return scale >= 0 ? [n * 10n ** BigInt(scale), 1n] : [n, 10n ** BigInt(-scale)];
}

// The first tick at a time or later, 0 to 2^48.
export function tickAt(track, seconds) {
  if (!(seconds > 0)) return 0;
  const about = (seconds * track.rateNum) / track.rateDen;
  if (about >= TICK_BOUND) return TICK_BOUND;
  if (about < 1e-9) return 1;
  return Math.min(Number(firstTick(track, ...exact(seconds))), TICK_BOUND);
}

// The rate in lowest terms.
function ratioOf(track) {
  if (!track.ratio) {
    let [a, b] = [track.rateNum, track.rateDen];
    while (b) [a, b] = [b, a % b];
    track.ratio = { num: track.rateNum / a, den: track.rateDen / a };
  }
  return track.ratio;
}

// TIM-001.
export function secondsAt(track, tick) {
  const { num, den } = ratioOf(track);
  return (tick * den) / num;
}

export function secondsBetween(track, first, stop) {
  const times = new Float64Array(stop - first);
  const { num, den } = ratioOf(track);
  for (let i = 0; i < times.length; i++) times[i] = ((first + i) * den) / num;
  return times;
}

// What spans leave out of a stretch of ticks, as seconds.
export function gapsBetween(track, spans, first, stop) {
  const gaps = [];
  let at = first;
  for (const [from, to] of spans) {
    if (from > at) gaps.push([secondsAt(track, at), secondsAt(track, from)]);
    at = Math.max(at, to);
  }
  if (stop > at) gaps.push([secondsAt(track, at), secondsAt(track, stop)]);
  return gaps;
}
