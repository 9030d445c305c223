// Calibrations and physical values (clause 8).
import { broken } from './error.js';

const CALIBRATION_BOUND = 2 ** 52;
const PRODUCT_BOUND = 2n ** 53n;

export function readCalibration(reader) {
  const { offset } = reader;
  const A = reader.svarint();
  const B = reader.svarint();
  const D = reader.varint();
  if (D < 1 || A === 0 || Math.abs(A) >= CALIBRATION_BOUND || Math.abs(B) >= CALIBRATION_BOUND) {
    broken('VAL-001', `calibration ${A}, ${B}, ${D}`, offset);
  }
  return { A, B, D };
}

// VAL-001 for a track, and for its HF track where that is given.
export function checkCalibration({ A, B }, track, hfTrack, offset) {
  const product = (count) => BigInt(count) * BigInt(A);
  const fits = (v) => v <= PRODUCT_BOUND && v >= -PRODUCT_BOUND;
  for (const count of [track.countMin, track.countMax]) {
    if (!fits(product(count)) || !fits(product(count) + BigInt(B))) {
      broken('VAL-001', `count ${count} has no exact physical value`, offset);
    }
  }
  if (!hfTrack) return;
  for (const count of [hfTrack.countMin, hfTrack.countMax]) {
    if (!fits(product(count))) broken('VAL-001', `count ${count} of the residual has no exact physical value`, offset);
  }
}

// VAL-003: one division of two exact binary64 integers.
export function physicalValue({ A, B, D }, count) {
  return (count * A + B) / D;
}
