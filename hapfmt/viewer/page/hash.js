// What is shown, in the URL after #, so that a link or a reload shows it again.
import { atMostEvery } from './dom.js';

const CHOICES = { mode: ['stacked', 'overlaid', 'map'], fit: ['view', 'all'], theme: ['auto', 'light', 'dark'], align: ['epoch', 'start'] };
const KEYS = ['t0', 't1', 'mode', 'pairs', 'bands', 'fit', 'theme', 'align', 'deadband', 'knots', 'a', 'b', 'tab', 'dock', 'dockHeight', 'side', 'filter', 'shown', 'entries', 'focus'];

export function writeHash(app, defaults) {
  const { state, selection } = app;
  const write = atMostEvery(200, () => {
    if (!app.ready) return;
    const text = hashOf(state, selection, defaults);
    if (text !== location.hash.slice(1)) history.replaceState(history.state, '', text ? `#${text}` : location.pathname + location.search);
  });
  state.on(KEYS, write);
  selection.onChange(write);
}

function hashOf(state, selection, defaults) {
  const parts = new URLSearchParams();
  if (state.moved) parts.set('t', `${state.t0},${state.t1}`);
  for (const key of ['mode', 'fit', 'theme', 'align', 'tab', 'filter']) if (state[key] !== defaults[key]) parts.set(key, state[key]);
  for (const key of ['deadband', 'knots', 'dock', 'side', 'pairs']) if (state[key] !== defaults[key]) parts.set(key, state[key] ? '1' : '0');
  if (state.bands.join() !== defaults.bands.join()) parts.set('band', state.bands.join());
  if (state.dockHeight !== defaults.dockHeight) parts.set('height', state.dockHeight);
  for (const key of ['a', 'b']) if (state[key] !== null) parts.set(key, state[key]);
  if (selection.range) parts.set('sel', selection.range.join());
  if (state.focus) parts.set('focus', state.focus);
  if (state.entries.some(({ lanes }) => lanes.some(({ shown }) => !shown))) {
    parts.set('ch', state.entries.map(({ lanes }) => rangesOf(lanes)).join(';'));
  }
  return parts.toString().replaceAll('%2C', ',').replaceAll('%3B', ';').replaceAll('%3A', ':');
}

// Shown lanes by their place: 0-3,7
function rangesOf(lanes) {
  const ranges = [];
  lanes.forEach(({ shown }, i) => {
    const last = ranges[ranges.length - 1];
    if (!shown) return;
    if (last && last[1] === i - 1) last[1] = i;
    else ranges.push([i, i]);
  });
  return ranges.map(([first, last]) => (first === last ? `${first}` : `${first}-${last}`)).join();
}

const numbers = (text) => (text ?? '').split(',').map((part) => (part.trim() === '' ? NaN : Number(part)));

// Values of the state that need no file.
export function readHash() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const found = {};
  for (const [key, allowed] of Object.entries(CHOICES)) if (allowed.includes(parts.get(key))) found[key] = parts.get(key);
  for (const key of ['deadband', 'knots', 'dock', 'side', 'pairs']) if (['0', '1'].includes(parts.get(key))) found[key] = parts.get(key) === '1';
  if (parts.has('tab')) found.dock ??= true;
  for (const key of ['tab', 'filter', 'focus']) if (parts.has(key)) found[key] = parts.get(key);
  const bands = (parts.get('band') ?? '').split(',').filter((band) => ['sum', 'lf', 'hf'].includes(band));
  if (bands.length) found.bands = [...new Set(bands)];
  for (const key of ['a', 'b']) if (Number.isFinite(numbers(parts.get(key))[0])) [found[key]] = numbers(parts.get(key));
  const height = numbers(parts.get('height'))[0];
  if (height >= 90 && height <= 2000) found.dockHeight = height;
  return found;
}

// What needs the files: -> { view, selection, shown(entries) }.
export function readHashOfFiles() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const pair = (key) => {
    const [t0, t1] = numbers(parts.get(key));
    return Number.isFinite(t0) && t1 > t0 && Number.isFinite(t1) ? [t0, t1] : null;
  };
  return { view: pair('t'), selection: pair('sel'), channels: parts.get('ch') };
}

export function applyChannels(entries, text) {
  text.split(';').forEach((ranges, i) => {
    const lanes = entries[i]?.lanes;
    if (!lanes) return;
    for (const lane of lanes) lane.shown = false;
    for (const range of ranges.split(',').filter(Boolean)) {
      const [first, last = first] = range.split('-').map(Number);
      for (let j = Math.max(0, first); j <= Math.min(last, lanes.length - 1); j++) lanes[j].shown = true;
    }
  });
}
