// An encoder of EVNT (9.9).
import { putVarint } from '../../../hapfmt/viewer/decoder/bytes.js';
import { unsupported } from '../../../hapfmt/viewer/decoder/error.js';

const SPAN_BOUND = 2 ** 24;
const EVENT_BOUND = 65536;
const SIZE_BOUND = 65535;
const PACKET_BYTES = 2 ** 18;

// events: [tick, duration, channel | null, text]. -> packets in order of time.
export function encodeEvents(track, events) {
  const packets = [];
  let open = null; // { start, last, count, bytes }
  const close = () => {
    if (open === null) return;
    packets.push({ track, start: open.start, span: open.last - open.start + 1, bytes: Uint8Array.from(open.bytes) });
    open = null;
  };
  for (const [tick, duration, channel, text] of [...events].sort((a, b) => a[0] - b[0])) {
    const letters = new TextEncoder().encode(text);
    if (letters.length > SIZE_BOUND || letters.includes(0)) unsupported('LIM-003', 'a text that no event can hold', null);
    if (open && (tick - open.start >= SPAN_BOUND || open.count === EVENT_BOUND || open.bytes.length > PACKET_BYTES)) close();
    open ??= { start: tick, last: tick, count: 0, bytes: [] };
    putVarint(open.bytes, tick - open.last);
    putVarint(open.bytes, duration);
    putVarint(open.bytes, channel === null ? 0 : channel + 1);
    putVarint(open.bytes, letters.length);
    for (const byte of letters) open.bytes.push(byte);
    open.last = tick;
    open.count++;
  }
  close();
  return packets;
}
