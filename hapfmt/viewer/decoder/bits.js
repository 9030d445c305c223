// Bits from the highest of a byte to its lowest (9.2). Behind the end zeros are read; who reads
// checks `position` against `size`.

import { POWERS } from './integers.js';

export class BitReader {
  constructor(bytes) {
    this.bytes = bytes;
    this.position = 0;
    this.size = 8 * bytes.length;
  }

  bit() {
    const at = this.position++;
    return (this.bytes[at >> 3] >> (7 - (at & 7))) & 1; // undefined >> n is 0
  }

  // The next n bits, n <= 24, without taking them.
  peek(n) {
    const { bytes, position } = this;
    const at = position >> 3;
    const word = (bytes[at] << 24) | (bytes[at + 1] << 16) | (bytes[at + 2] << 8) | bytes[at + 3];
    return n === 0 ? 0 : (word << (position & 7)) >>> (32 - n);
  }

  // The number of the next n bits, n <= 53.
  take(n) {
    let value = 0;
    for (; n > 24; n -= 24) {
      value = value * 16777216 + this.peek(24);
      this.position += 24;
    }
    value = value * POWERS[n] + this.peek(n);
    this.position += n;
    return value;
  }

  // How many bytes hold the bits that were read, and whether the bits behind them in the last one are 0.
  get usedBytes() {
    return (this.position + 7) >> 3;
  }

  get filledWithZeros() {
    const rest = this.position & 7;
    return rest === 0 || (this.bytes[this.position >> 3] & (255 >> rest)) === 0;
  }
}
