// Levels and limits (clause 12).
import { unsupported } from './error.js';

export const LIMITS = {
  1: {
    level: 1, rangeBits: 24, hfRangeBits: 25, countBound: 2 ** 24, stepBound: 2 ** 24,
    spanBound: 2 ** 24, payloadBound: 2 ** 20, sampleBound: 2 ** 22, packetBound: 2 ** 14,
  },
  2: {
    level: 2, rangeBits: 32, hfRangeBits: 32, countBound: 2 ** 32, stepBound: 2 ** 31,
    spanBound: 2 ** 24, payloadBound: 2 ** 24, sampleBound: 2 ** 28, packetBound: 2 ** 17,
  },
};
export const TRACK_BOUND = 65534;
export const TICK_BOUND = 2 ** 48;

export function limitsOf(level) {
  return LIMITS[level] ?? unsupported('HED-004', `level ${level}`);
}
