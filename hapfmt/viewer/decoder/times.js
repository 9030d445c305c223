// Time (clause 7) and maps to the time of another clock (11.6), exactly.
import { floorDivBig, rdivBig } from './integers.js';

const ceilDivBig = (a, b) => -floorDivBig(-a, b);

// The first tick at or after a time of n / d seconds: the range t0 <= t < t1 selects firstTick(t0) to firstTick(t1) - 1.
export function firstTick({ rateNum, rateDen }, n, d) {
  return ceilDivBig(BigInt(n) * BigInt(rateNum), BigInt(d) * BigInt(rateDen));
}

// TIM-001: tick * rate_den / rate_num seconds; as a fraction in lowest terms, and as a Number.
export function secondsOf({ rateNum, rateDen }, tick) {
  let a = BigInt(tick) * BigInt(rateDen);
  let b = BigInt(rateNum);
  const fraction = [a, b];
  if (a < 0n) a = -a;
  while (b !== 0n) [a, b] = [b, a % b];
  return fraction.map((v) => v / (a === 0n ? 1n : a));
}

// From one column of the points to the other, on the line of the last point that is not behind x.
function alongLine(points, x, from, to) {
  let i = 0;
  while (i + 2 < points.length && x >= BigInt(points[i + 1][from])) i++;
  const [a, b] = [points[i], points[i + 1]].map((point) => ({ x: BigInt(point[from]), y: BigInt(point[to]) }));
  return a.y + rdivBig((b.y - a.y) * (x - a.x), b.x - a.x);
}

// points: { tick, timeNs } of a map; BigInts come out.
export function timeOfTick(points, tick) {
  return alongLine(points, BigInt(tick), 'tick', 'timeNs');
}

export function tickOfTime(points, time) {
  return alongLine(points, BigInt(time), 'timeNs', 'tick');
}
