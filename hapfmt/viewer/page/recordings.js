// The opened files and their channels on one time line.
import { unitText } from '../data/bounds.js';
import { openRecording } from '../data/client.js';
import { listDamage, listEvents } from './marks.js';

// The code of the worker is a text within the page.
function startWorker() {
  const url = URL.createObjectURL(new Blob([globalThis.hapfWorkerCode], { type: 'text/javascript' }));
  const worker = new Worker(url);
  URL.revokeObjectURL(url);
  return worker;
}

// A lane: one channel of one recording.
export function lanesOf(entry) {
  return entry.recording.channels.map((channel) => {
    const { label, unit, group, device, quantity, axis } = channel;
    const [num, den] = `${channel.rateText ?? channel.rate}`.split('/').map(Number);
    return {
      entry,
      channel,
      index: channel.index,
      key: `${entry.number}:${channel.index}`,
      name: label || `channel ${channel.index}`,
      unit: unitText(unit),
      rate: num / (den || 1) || channel.rate,
      text: [label || `channel ${channel.index}`, unit, group, device, quantity, axis, entry.name].filter(Boolean).join(' ').toLowerCase(),
      color: 0,
      twin: null,
      step: channel.step,
      shown: true,
    };
  });
}

// Why a file is not shown, in plain words.
export function explain(error, name) {
  const place = Number.isFinite(error.offset) && error.offset !== null ? ` at byte ${error.offset}` : '';
  const rule = error.requirement ? ` (${error.requirement}${place})` : '';
  if (error.size === 0) return `${name} is not a hapf file: it is empty.`;
  if (error.requirement === 'FIL-001') return `${name} is not a hapf file${rule}.`;
  if (error.kind === 'unsupported') return `This viewer cannot read ${name}: ${error.message}${rule}.`;
  return `${name} cannot be opened: ${error.message}${rule}.`;
}

let opened = 0;

// source: { name, url } | { name, blob } | { name, bytes }.
export async function addRecording(state, source) {
  const number = opened++;
  const entry = { number, name: source.name, source, offset: 0, damage: [], events: [], findings: null };
  state.set({ pending: state.pending + 1 });
  try {
    entry.recording = await openRecording(source, { worker: startWorker, onChange: (what, news) => changed(state, entry, what, news) });
  } catch (error) {
    state.set({ pending: state.pending - 1, failures: [...state.failures, { name: source.name, text: explain(error, source.name) }] });
    return null;
  }
  entry.lanes = lanesOf(entry);
  const entries = [...state.entries, entry].sort((a, b) => a.number - b.number);
  state.set({ pending: state.pending - 1, entries, ...timeLine(entries, state.align) });
  listEvents(state, entry);
  listDamage(state, entry);
  return entry;
}

export function closeAll(state) {
  for (const entry of state.entries) entry.recording.close();
  state.set({ entries: [], failures: [], pending: 0, start: 0, stop: 0 });
}

function changed(state, entry, what, news) {
  if (what === 'progress') {
    const share = news.size ? ` ${Math.round((100 * news.done) / news.size)} %` : '';
    state.set({ progress: `Reading ${entry.name}${share}` });
    return;
  }
  if (what === 'error') {
    state.set({ failures: [...state.failures, { name: entry.name, text: explain(news.error, entry.name) }] });
    return;
  }
  if (!entry.recording) return;
  if (what === 'damage') listDamage(state, entry);
  if (news.facts) state.set(timeLine(state.entries, state.align));
  entry.version = (entry.version ?? 0) + 1;
  state.tell(new Set(['signals', 'facts']));
}

const epochOf = ({ recording }) => (recording.epochNs === null || recording.epochNs === undefined ? null : BigInt(recording.epochNs));

export function canAlignByEpoch(entries) {
  return entries.length > 1 && entries.every((entry) => epochOf(entry) !== null);
}

// Offsets of the files, in seconds, and the ends of the time line. The first file keeps its own times.
export function timeLine(entries, align) {
  if (!entries.length) return { start: 0, stop: 0 };
  const byEpoch = align !== 'start' && canAlignByEpoch(entries);
  const [first] = entries;
  for (const entry of entries) {
    const { recording } = entry;
    if (byEpoch) entry.offset = Number(epochOf(entry) - epochOf(first)) / 1e9;
    else entry.offset = entry === first ? 0 : first.recording.start - recording.start;
  }
  const start = Math.min(...entries.map(({ recording, offset }) => recording.start + offset));
  const stop = Math.max(...entries.map(({ recording, offset }) => recording.stop + offset));
  return { start, stop: stop > start ? stop : start + 1e-3 };
}
