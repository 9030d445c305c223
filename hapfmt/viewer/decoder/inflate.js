// DEFLATE (RFC 1951) to a known size, for TRAK (6.3) and RAWB (9.3).
import { broken } from './error.js';

const LENGTH_BASE = [
  3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
const LENGTH_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCE_BASE = [
  1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145,
  8193, 12289, 16385, 24577];
const DISTANCE_BITS = [
  0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13];
const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
const QUICK = 10;

// Code words come lowest bit first: a table by the next QUICK bits, and for longer ones the canonical rule.
class Code {
  constructor(lengths, partial, fail) {
    this.counts = new Uint16Array(16);
    for (const length of lengths) this.counts[length]++;
    this.counts[0] = 0;
    let left = 1;
    let used = 0;
    for (let n = 1; n < 16; n++) {
      left = 2 * left - this.counts[n];
      used += this.counts[n];
      if (left < 0) fail('code words that are too many');
    }
    // A code of one word of one bit, or of none, may be incomplete.
    if (left > 0 && !(partial && (used === 0 || (used === 1 && this.counts[1] === 1)))) {
      fail('code words that are not complete');
    }
    const next = new Uint16Array(16);
    const starts = new Uint16Array(17);
    for (let n = 1; n < 16; n++) {
      next[n] = (next[n - 1] + this.counts[n - 1]) << 1;
      starts[n + 1] = starts[n] + this.counts[n];
    }
    this.symbols = new Uint16Array(used);
    this.quick = new Uint16Array(1 << QUICK); // 16 * symbol + length; 0: longer, or none
    for (let symbol = 0; symbol < lengths.length; symbol++) {
      const n = lengths[symbol];
      if (n === 0) continue;
      this.symbols[starts[n]++] = symbol;
      const word = next[n]++;
      if (n > QUICK) continue;
      let reversed = 0;
      for (let i = 0; i < n; i++) reversed |= ((word >> i) & 1) << (n - 1 - i);
      for (let i = reversed; i < 1 << QUICK; i += 1 << n) this.quick[i] = 16 * symbol + n;
    }
  }
}

const fixedLengths = new Uint8Array(288).fill(8, 0, 144).fill(9, 144, 256).fill(7, 256, 280).fill(8, 280, 288);
let fixedCodes = null;

class Inflater {
  constructor(bytes, offset, rule) {
    this.bytes = bytes;
    this.offset = offset;
    this.at = 0;
    this.hold = 0;
    this.held = 0;
    this.rule = rule;
    this.fail = (message) => broken(rule, `DEFLATE: ${message}`, offset + this.at);
  }

  // The next n bits, n <= 16, the first being the lowest.
  bits(n) {
    while (this.held < n) {
      if (this.at >= this.bytes.length) this.fail('the stream is cut');
      this.hold |= this.bytes[this.at++] << this.held;
      this.held += 8;
    }
    const value = this.hold & ((1 << n) - 1);
    this.hold >>>= n;
    this.held -= n;
    return value;
  }

  symbol(code) {
    while (this.held < 15 && this.at < this.bytes.length) {
      this.hold |= this.bytes[this.at++] << this.held;
      this.held += 8;
    }
    const entry = code.quick[this.hold & ((1 << QUICK) - 1)];
    let length = entry & 15;
    let symbol = entry >> 4;
    if (entry === 0) {
      let word = 0;
      let first = 0;
      let index = 0;
      for (length = 1; ; length++) {
        if (length > 15) this.fail('bits that are no code word');
        word |= (this.hold >>> (length - 1)) & 1;
        const count = code.counts[length];
        if (word - first < count) {
          symbol = code.symbols[index + word - first];
          break;
        }
        index += count;
        first = (first + count) << 1;
        word <<= 1;
      }
    }
    if (length > this.held) this.fail('the stream is cut');
    this.hold >>>= length;
    this.held -= length;
    return symbol;
  }

  codes() {
    const literals = this.bits(5) + 257;
    const distances = this.bits(5) + 1;
    const count = this.bits(4) + 4;
    if (literals > 286 || distances > 30) this.fail('too many symbols');
    const first = new Uint8Array(19);
    for (let i = 0; i < count; i++) first[ORDER[i]] = this.bits(3);
    const code = new Code(first, false, this.fail);
    const lengths = new Uint8Array(literals + distances);
    for (let i = 0; i < lengths.length;) {
      const symbol = this.symbol(code);
      if (symbol < 16) {
        lengths[i++] = symbol;
        continue;
      }
      if (symbol === 16 && i === 0) this.fail('a repetition of nothing');
      const value = symbol === 16 ? lengths[i - 1] : 0;
      const times = symbol === 16 ? 3 + this.bits(2) : symbol === 17 ? 3 + this.bits(3) : 11 + this.bits(7);
      if (i + times > lengths.length) this.fail('too many lengths');
      lengths.fill(value, i, i + times);
      i += times;
    }
    if (lengths[256] === 0) this.fail('no end of block');
    return [
      new Code(lengths.subarray(0, literals), true, this.fail),
      new Code(lengths.subarray(literals), true, this.fail),
    ];
  }

  run(out) {
    let filled = 0;
    const more = () => broken(this.rule, 'DEFLATE: more bytes than it should give', this.offset + this.at);
    for (let last = 0; last === 0;) {
      last = this.bits(1);
      const method = this.bits(2);
      if (method === 3) this.fail('a block of type 3');
      if (method === 0) {
        this.at -= this.held >> 3;
        this.hold = this.held = 0;
        const size = this.bits(16);
        if ((this.bits(16) ^ size) !== 0xffff) this.fail('a stored block without its complement');
        if (size > this.bytes.length - this.at) this.fail('the stream is cut');
        if (size > out.length - filled) more();
        out.set(this.bytes.subarray(this.at, this.at + size), filled);
        filled += size;
        this.at += size;
        continue;
      }
      fixedCodes ??= [new Code(fixedLengths, false, this.fail), new Code(new Uint8Array(32).fill(5), false, this.fail)];
      const [literal, distance] = method === 1 ? fixedCodes : this.codes();
      for (;;) {
        const symbol = this.symbol(literal);
        if (symbol < 256) {
          if (filled === out.length) more();
          out[filled++] = symbol;
          continue;
        }
        if (symbol === 256) break;
        if (symbol > 285) this.fail('a length that is not defined');
        const length = LENGTH_BASE[symbol - 257] + this.bits(LENGTH_BITS[symbol - 257]);
        const code = this.symbol(distance);
        if (code > 29) this.fail('a distance that is not defined');
        const back = DISTANCE_BASE[code] + this.bits(DISTANCE_BITS[code]);
        if (back > filled) this.fail('a distance before the start');
        if (length > out.length - filled) more();
        if (back >= length) {
          out.copyWithin(filled, filled - back, filled - back + length);
          filled += length;
        } else {
          for (const end = filled + length; filled < end; filled++) out[filled] = out[filled - back];
        }
      }
    }
    if (filled < out.length) broken(this.rule, 'DEFLATE: fewer bytes than it should give', this.offset);
    // Whole bytes that were fetched ahead do not belong to the stream.
    return this.at - (this.held >> 3);
  }
}

// Gives the `size` bytes of the stream; it ends with `bytes`. rule: the one that another size and a
// bad stream break.
export function inflate(bytes, size, offset, rule) {
  // Two bits give 258 bytes at most: more is not allocated (LIM-002).
  if (size > 1032 * bytes.length) broken(rule, 'DEFLATE: fewer bytes than it should give', offset);
  const out = new Uint8Array(size);
  const used = new Inflater(bytes, offset, rule).run(out);
  if (used < bytes.length) broken(rule, `${bytes.length - used} bytes after the DEFLATE stream`, offset + used);
  return out;
}
