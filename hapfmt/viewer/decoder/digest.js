// The digest of a track (11.5).
import { Sha256, sha256 } from './sha256.js';
import { pushSpan } from './spans.js';

// Typed arrays lie in memory as the format has numbers, little-endian, wherever this runs.
const bytesOf = (array) => new Uint8Array(array.buffer, array.byteOffset, array.byteLength);

export class TrackDigest {
  constructor() {
    this.numbers = new Sha256();
    this.spans = [];
  }

  // The packets of a track come in order of time.
  add(start, span, { numbers, exact }) {
    this.numbers.update(bytesOf(exact ?? numbers));
    pushSpan(this.spans, start, start + span);
  }

  value() {
    const whole = new Uint8Array(32 + 16 * this.spans.length);
    const view = new DataView(whole.buffer);
    whole.set(this.numbers.digest());
    this.spans.forEach(([start, stop], i) => {
      view.setBigUint64(32 + 16 * i, BigInt(start), true);
      view.setBigUint64(40 + 16 * i, BigInt(stop - start), true);
    });
    return sha256(whole);
  }
}
