// Events and damage on the time line: { time0, time1, entry, title, text, kind, channels } sorted by time.
import { showSpan } from './view.js';

// Codes of damage for people, as hapfmt/reading/damage.py has them.
export const WORDS = {
  'bad-signature': 'wrong first bytes', garbage: 'foreign bytes', 'other-file': 'parts of another file', 'duplicate-chunk': 'a chunk twice',
  'missing-chunk': 'missing chunks', 'out-of-order': 'chunks in the wrong order', truncated: 'a chunk cut short', 'bad-payload': 'wrong checksum',
  'bad-table': 'a damaged table of packets', 'bad-packet': 'damaged packets', overlap: 'packets that overlap', 'bad-chunk': 'a chunk that breaks a rule',
  'missing-head': 'no header chunk', 'lost-base': 'an HF track without its LF track', 'bad-digest': 'wrong SHA-256 checksum',
};

export async function listEvents(state, entry) {
  const { recording } = entry;
  try {
    const events = await recording.events(recording.start, recording.stop);
    entry.events = Array.from(events, (event) => ({
      kind: 'event',
      entry,
      time0: event.time,
      time1: event.time + (event.duration || 0),
      title: event.label || event.text || event.kind || 'event',
      text: event.kind && event.kind !== event.text ? event.kind : '',
      channels: event.channel === null || event.channel === undefined ? null : [event.channel],
    })).sort((a, b) => a.time0 - b.time0);
  } catch (error) {
    entry.eventError = error.message;
  }
  state.tell(new Set(['marks']));
}

export async function listDamage(state, entry) {
  try {
    const found = await entry.recording.damage();
    entry.damage = Array.from(found, (one) => damageMark(entry, one)).sort((a, b) => a.time0 - b.time0);
  } catch (error) {
    entry.damageError = error.message;
  }
  state.tell(new Set(['marks', 'facts']));
}

function damageMark(entry, { time0, time1, channels, code, requirement, message, offset, size }) {
  const whole = time0 === null || time0 === undefined;
  const place = Number.isFinite(offset) && offset !== null ? `byte ${offset}${size ? `, ${size} bytes` : ''}` : '';
  return {
    kind: 'damage',
    entry,
    whole,
    time0: whole ? entry.recording.start : time0,
    time1: whole ? entry.recording.stop : time1 ?? time0,
    title: WORDS[code] ?? code ?? 'damage',
    text: [message, requirement, place].filter(Boolean).join(' · '),
    channels: channels ?? null,
  };
}

// Sets state.marks = { event: { list, starts }, damage: ... }: the marks of all files on the common time line.
export function collectMarks(state) {
  const sorted = (lists) => {
    const list = lists.flat().sort((a, b) => spanOf(a)[0] - spanOf(b)[0]);
    return { list, starts: Float64Array.from(list, (mark) => spanOf(mark)[0]) };
  };
  // Damage of a whole file is in the list, not on the time line.
  state.wholeDamage = state.entries.flatMap(({ damage }) => damage.filter(({ whole }) => whole));
  state.marks = {
    event: sorted(state.entries.map(({ events }) => events)),
    damage: sorted(state.entries.map(({ damage }) => damage.filter(({ whole }) => !whole))),
  };
}

export function spanOf({ entry, time0, time1 }) {
  return [time0 + entry.offset, time1 + entry.offset];
}

// Whether a mark is of this channel, or of the whole file of this channel.
export function concerns(mark, lane) {
  return mark.entry === lane.entry && (mark.channels === null || mark.channels.includes(lane.index));
}

// Shows a mark, and the first of its channels that is shown.
export function goToMark(app, mark) {
  const { state } = app;
  if (!mark.whole) showSpan(state, ...spanOf(mark));
  const lane = mark.channels && state.lanes.find((one) => concerns(mark, one));
  if (lane) app.focusLane(lane);
  state.visited = { mark, t0: state.t0, t1: state.t1 };
}

// The mark after the one that was gone to (direction 1), or the one before it (−1). If the view has moved since, that
// after or before the middle of the view; of the whole time line, the first or the last.
export function nextMark(state, kind, direction) {
  const { list } = state.marks[kind];
  const { visited } = state;
  const at = visited && visited.t0 === state.t0 && visited.t1 === state.t1 ? list.indexOf(visited.mark) : -1;
  if (at >= 0) return list[at + direction];
  if (!state.moved) return list.at(direction > 0 ? 0 : -1);
  const middle = (state.t0 + state.t1) / 2;
  const nudge = (state.t1 - state.t0) * 1e-6;
  const centre = (mark) => (spanOf(mark)[0] + spanOf(mark)[1]) / 2;
  const found = list.filter((mark) => (centre(mark) - middle) * direction > nudge);
  return direction > 0 ? found[0] : found[found.length - 1];
}
