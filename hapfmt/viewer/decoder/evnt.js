// EVNT (9.9): events of one layer.
import { Reader } from './bytes.js';
import { broken } from './error.js';
import { TICK_BOUND } from './limits.js';

const EVENT_BOUND = 65536;
const SIZE_BOUND = 65535;
const CHANNEL_BOUND = 65535;

export function decodeEvents(track, bytes, start, span, offset = 0) {
  const reader = new Reader(bytes, { base: offset, requirement: 'EVT-001' });
  const events = [];
  let tick = start;
  if (bytes.length === 0) broken('EVT-001', 'a packet without events', offset);
  while (reader.left > 0) {
    const at = reader.offset;
    if (events.length === EVENT_BOUND) broken('EVT-001', `more than ${EVENT_BOUND} events`, at);
    tick += reader.varint();
    if (tick >= start + span) broken('EVT-001', `an event at tick ${tick}`, at);
    const duration = reader.varint();
    if (duration > TICK_BOUND - tick) broken('EVT-001', `an event of ${duration} ticks`, at);
    const channel = reader.varint();
    if (channel > CHANNEL_BOUND) broken('EVT-003', `an event of channel ${channel}`, at);
    const size = reader.varint();
    if (size > SIZE_BOUND) broken('EVT-003', `an event with a text of ${size} bytes`, at);
    events.push({ tick, duration, channel: channel === 0 ? null : channel - 1, text: reader.text(size) });
  }
  return events;
}
