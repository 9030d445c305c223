// What the tools work on: the selection, or what is in sight where nothing is selected.
import { formatDuration } from './format.js';

const CHUNK = 2 ** 16; // samples at a time
const MOST = 1e9; // a file of few bytes can have a long gap

// Seconds of one recording, [t0, t1); null: nothing of it is chosen.
export function spanFor({ state, selection }, entry) {
  if (selection.range) return selection.within(entry);
  const { recording, offset } = entry;
  const start = Math.max(recording.start, state.t0 - offset);
  const stop = Math.min(recording.stop, state.t1 - offset);
  return start < stop ? [start, stop] : null;
}

export function spanText({ state, selection }) {
  const [t0, t1] = selection.range ?? [Math.max(state.start, state.t0), Math.min(state.stop, state.t1)];
  return `${selection.range ? 'Selection' : 'In sight'}: ${formatDuration(Math.max(0, t1 - t0))}`;
}

// The channel in focus, else the first that is shown.
export function laneInFocus({ state }) {
  return state.lanes.find(({ key }) => key === state.focus) ?? state.lanes[0] ?? null;
}

export const namedLane = ({ state }, lane) => (state.entries.length > 1 ? `${lane.entry.name}: ` : '') + lane.name;

// All samples of a lane in [t0, t1), in parts: take(part, share that is done). Rejects where `signal` is aborted.
export async function eachPart(lane, [t0, t1], band, signal, take) {
  const { recording } = lane.entry;
  if ((t1 - t0) * lane.rate > MOST) throw new Error('There are more than 10⁹ samples: select fewer');
  const parts = Math.max(1, Math.ceil(((t1 - t0) * lane.rate) / CHUNK));
  const border = (i) => (i === parts ? t1 : t0 + ((t1 - t0) * i) / parts);
  for (let i = 0; i < parts; i++) {
    take(await recording.samples(lane.index, border(i), border(i + 1), band, { signal }), (i + 1) / parts);
  }
}
