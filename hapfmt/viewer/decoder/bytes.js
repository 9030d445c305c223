// Reading bytes: the notation, varints and texts of clause 2.
import { HapfError, broken, truncated } from './error.js';

const UTF8 = new TextDecoder('utf-8', { fatal: true, ignoreBOM: true });

export function decodeText(bytes, offset) {
  if (bytes.includes(0)) broken('CNV-004', 'a text with U+0000', offset);
  try {
    return UTF8.decode(bytes);
  } catch {
    return broken('CNV-004', 'a text that is not UTF-8', offset);
  }
}

export class Reader {
  // base: the offset in the file of bytes[0]; requirement: the rule that missing bytes break.
  constructor(bytes, { start = 0, end = bytes.length, base = 0, requirement = 'COD-001' } = {}) {
    this.source = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.position = start;
    this.end = end;
    this.base = base;
    this.requirement = requirement;
  }

  get left() {
    return this.end - this.position;
  }

  get offset() {
    return this.base + this.position;
  }

  take(n) {
    const at = this.position;
    if (n > this.end - at) truncated(this.requirement, `${n} bytes where ${this.end - at} are left`, this.base + at);
    this.position = at + n;
    return at;
  }

  u8() {
    return this.source[this.take(1)];
  }

  i8() {
    return this.view.getInt8(this.take(1));
  }

  u16() {
    return this.view.getUint16(this.take(2), true);
  }

  u32() {
    return this.view.getUint32(this.take(4), true);
  }

  i32() {
    return this.view.getInt32(this.take(4), true);
  }

  u64() {
    return this.view.getBigUint64(this.take(8), true);
  }

  i64() {
    return this.view.getBigInt64(this.take(8), true);
  }

  f32() {
    return this.view.getFloat32(this.take(4), true);
  }

  bytes(n) {
    const at = this.take(n);
    return this.source.subarray(at, at + n);
  }

  text(n) {
    const offset = this.offset;
    return decodeText(this.bytes(n), offset);
  }

  varint() {
    const { source, end } = this;
    const first = this.position;
    let value = 0;
    let scale = 1;
    for (let i = first; i < end; i++) {
      const byte = source[i];
      value += (byte & 127) * scale;
      if (byte < 128) {
        if (byte === 0 && i > first) broken('CNV-002', 'a varint that is not minimal', this.base + first);
        // Eight groups are 56 bits: the sum rounds, but never from 2^53 or more to below it.
        if (value >= 2 ** 53) broken('CNV-002', 'a varint of 2^53 or more', this.base + first);
        this.position = i + 1;
        return value;
      }
      scale *= 128;
      if (i === first + 7) broken('CNV-002', 'a varint of more than 8 bytes', this.base + first);
    }
    throw new HapfError('truncated', this.requirement, 'a varint without its end', this.base + first, ['CNV-002']);
  }

  svarint() {
    const u = this.varint();
    return u % 2 === 0 ? u / 2 : -((u + 1) / 2);
  }
}

export function putVarint(array, v) {
  for (; v >= 128; v = Math.floor(v / 128)) array.push((v % 128) + 128);
  array.push(v);
}

export function putSvarint(array, v) {
  putVarint(array, v < 0 ? -2 * v - 1 : 2 * v);
}
