// The page: its state, its parts, and what happens when something changes.
import { ChannelList, chooseLanes } from './channels.js';
import { Cursors } from './cursors.js';
import { Dock, isOpen } from './dock.js';
import { eachFrame, element, setText } from './dom.js';
import { acceptDrops } from './drop.js';
import { Flags, markText } from './flags.js';
import { formatStepped, withUnit } from './format.js';
import { applyChannels, readHash, readHashOfFiles, writeHash } from './hash.js';
import { Head } from './head.js';
import { Help, listenToKeys } from './keyboard.js';
import { collectMarks, concerns, spanOf } from './marks.js';
import { Panels } from './panels.js';
import { Pointer } from './pointer.js';
import { Readings } from './readings.js';
import { addRecording, canAlignByEpoch, closeAll, timeLine } from './recordings.js';
import { Selection } from './selection.js';
import { Signals } from './signals.js';
import { listSources } from './sources.js';
import { Store } from './store.js';
import { Strip } from './strip.js';
import { damageTab, eventsTab, checkedText } from './tab-marks.js';
import { filesTab } from './tab-files.js';
import { playTab } from './tab-play.js';
import { saveTab } from './tab-save.js';
import { spectrogramTab } from './tab-spectrogram.js';
import { spectrumTab } from './tab-spectrum.js';
import { statisticsTab } from './tab-statistics.js';
import { valuesTab } from './tab-values.js';
import { applyTheme, nextTheme } from './theme.js';
import { TimeAxis } from './times.js';
import { hideTip, showTip } from './tip.js';
import { moveInto, setView, showAll, widest, zoom } from './view.js';

const TABS = [valuesTab, eventsTab, damageTab, filesTab, spectrumTab, spectrogramTab, statisticsTab, saveTab, playTab];

const DEFAULTS = {
  mode: 'stacked', pairs: true, bands: ['sum'], fit: 'view', theme: 'auto', align: 'epoch', deadband: false, knots: false,
  dock: null, dockHeight: null, side: true, tab: 'values', filter: '',
};

const SMALL = 4e6; // bytes of a file that is checked as soon as it is open

const at = (id) => document.getElementById(id);
const fixed = { ...DEFAULTS, dock: innerHeight >= 700 ? null : false, side: innerWidth >= 700 };

const state = new Store({
  entries: [], failures: [], wholeDamage: [], pending: 0, progress: '', lanes: [], matching: [], start: 0, stop: 1, t0: 0, t1: 1, moved: false,
  marks: { event: { list: [], starts: new Float64Array() }, damage: { list: [], starts: new Float64Array() } },
  hover: null, a: null, b: null, focus: null, selecting: false, ...fixed, ...readHash(),
});

const app = { state, selection: new Selection(), ready: false };
app.app = app;
app.signals = new Signals(state, { wanted: () => app.panels.visibleLanes, width: () => app.panels.plotWidth, onData: () => drawSoon() });
app.panels = new Panels(state, app.signals, at('panels'));
app.readings = new Readings(state, app.signals, () => {
  drawSoon();
  onHover(pointed); // its values may have come
});
app.cursors = new Cursors(app, at('lines'));
app.axis = new TimeAxis(state, app.panels, at('times'));
app.strip = new Strip(app, at('strip'));
app.flags = new Flags(app, at('flags'));
app.help = new Help();

const actions = {
  toggle: (key) => state.set({ [key]: key === 'dock' ? !isOpen(state) : !state[key] }),
  toggleMode: () => state.set({ mode: { stacked: 'overlaid', overlaid: 'map', map: 'stacked' }[state.mode] }),
  toggleFit: () => state.set({ fit: state.fit === 'view' ? 'all' : 'view' }),
  toggleTheme: () => state.set({ theme: nextTheme(state.theme) }),
  toggleAlign: () => canAlignByEpoch(state.entries) && state.set({ align: state.align === 'epoch' ? 'start' : 'epoch' }),
  toggleBand: (band) => {
    const bands = ['sum', 'lf', 'hf'].filter((one) => (one === band) !== state.bands.includes(one));
    if (bands.length) state.set({ bands });
  },
  showAll: () => showAll(state),
  zoomBy: (factor) => zoom(state, factor),
  clear: () => {
    app.selection.clear();
    state.set({ a: null, b: null, focus: null });
  },
  stepCursor: (samples) => {
    const lane = state.lanes.find(({ key }) => key === state.focus) ?? app.panels.visibleLanes[0];
    if (!lane) return;
    const name = state.b !== null ? 'b' : 'a';
    const number = Math.round(((state[name] ?? (state.t0 + state.t1) / 2) - lane.entry.offset) * lane.rate) + samples;
    const time = number / lane.rate + lane.entry.offset;
    state.set({ [name]: time });
    moveInto(state, time);
  },
  stepLane: (step) => {
    if (!state.lanes.length) return;
    const now = state.lanes.findIndex(({ key }) => key === state.focus);
    const next = state.lanes[now < 0 ? 0 : Math.max(0, Math.min(state.lanes.length - 1, now + step))];
    actions.focusLane(next);
    actions.say(next.name);
  },
  focusLane: (lane) => {
    state.set({ focus: lane.key });
    app.panels.scrollTo(lane);
  },
  scrollPanels: (direction) => {
    at('panels').scrollTop += direction * at('panels').clientHeight * 0.9;
  },
  focusFilter: () => {
    state.set({ side: true });
    at('filter').focus();
  },
  chooseFiles: () => chooser.click(),
  openFiles: async (files, replace) => {
    if (replace) {
      closeAll(state);
      app.signals.forget();
      state.set({ moved: false, a: null, b: null, focus: null });
      app.selection.clear();
    }
    await Promise.all(files.map((file) => addRecording(state, { name: file.name, blob: file })));
  },
  verify: (entries = state.entries) => {
    for (const entry of entries) entry.checked = 'checking';
    if (entries.length) state.tell(new Set(['facts']));
    for (const entry of entries) lastCheck = lastCheck.then(() => verifyOne(entry));
    return lastCheck;
  },
  say: (text) => setText(at('status'), text),
};
Object.assign(app, actions);

// One after the other, so that many files do not start as many Workers.
let lastCheck = Promise.resolve();

async function verifyOne(entry) {
  if (!state.entries.includes(entry)) return;
  try {
    entry.findings = await entry.recording.verify();
    entry.checked = checkedText(entry.findings);
  } catch (error) {
    entry.checked = `not checked: ${error.message}`;
  }
  state.tell(new Set(['facts']));
}

const chooser = element('input', {
  type: 'file', multiple: true, accept: '.hapf', hidden: true, 'aria-label': 'Files to open',
  onchange: () => {
    app.openFiles([...chooser.files], false);
    chooser.value = '';
  },
});
document.body.append(chooser);

app.channels = new ChannelList(app, at('side'));
app.head = new Head(app, at('facts'), at('tools'));
app.dock = new Dock(app, at('dock'), TABS);
app.pointer = new Pointer({ ...app, onHover }, at('panels'));

function draw() {
  const began = performance.now();
  app.panels.draw();
  app.axis.draw();
  app.strip.draw();
  app.flags.draw();
  app.cursors.draw();
  app.dock.update();
  app.signals.refresh();
  const lane = app.strip.lane();
  if (lane && app.signals.complete) app.signals.refreshWhole(lane, app.panels.plotWidth);
  frames.push(performance.now() - began);
  if (frames.length > 1000) frames.shift();
}

const frames = [];
const drawSoon = eachFrame(draw);
const hoverSoon = eachFrame(() => {
  app.cursors.draw();
  app.dock.update();
});

// Damage under the pointer tells its finding.
let pointed = null; // the last event of the pointer over the charts

function onHover(event) {
  pointed = event;
  if (!event || state.hover === null) {
    hideTip();
    return;
  }
  const { top } = at('panels').getBoundingClientRect();
  const group = app.panels.groups[Math.floor((event.clientY - top + at('panels').scrollTop) / app.panels.rowHeight)];
  const chart = app.panels.open.get(group?.key)?.chart;
  const lane = chart?.laneAt?.(event.clientY - chart.canvas.getBoundingClientRect().top);
  if (lane) {
    const reading = app.readings.at(lane, state.hover);
    showTip(`${lane.name}: ${reading ? withUnit(formatStepped(reading.value, lane.step), lane.unit) : '…'}`, event.clientX, event.clientY);
    return;
  }
  const near = (2 * (state.t1 - state.t0)) / app.panels.plotWidth;
  const found = group && state.marks.damage.list.find((mark) => spanOf(mark)[0] - near <= state.hover && spanOf(mark)[1] + near >= state.hover
    && group.lanes.some((lane) => concerns(mark, lane)));
  if (found) showTip(markText(found), event.clientX, event.clientY);
  else hideTip();
}

function showEmpty() {
  const { empty } = app.panels;
  const total = state.entries.reduce((sum, { lanes }) => sum + lanes.length, 0);
  let text = '';
  if (state.pending && !state.entries.length) text = state.progress || 'Reading …';
  else if (!state.entries.length) text = state.failures.length ? 'Nothing to show. Drop another .hapf file here, or press Open.' : 'Drop a .hapf file here, or press Open.';
  else if (!total) text = 'This recording has no channels.';
  else if (!state.matching.length) text = 'No channel matches the filter.';
  else if (!state.lanes.length) text = 'No channel is shown. Choose some in the list.';
  setText(empty, text);
  empty.hidden = !text;
}

function showFailures() {
  at('notices').replaceChildren(...state.failures.map((failure) => element('p', { class: 'notice' }, element('bdi', {}, failure.text), element('button', {
    type: 'button', 'aria-label': 'Close this message', onclick: () => state.set({ failures: state.failures.filter((one) => one !== failure) }),
  }, '×'))));
}

function rebuild() {
  app.panels.build();
  showEmpty();
  drawSoon();
}

// First of all: what is drawn after a change of the theme has its colours.
state.on(['theme'], () => applyTheme(state.theme));
state.on(['t0', 't1'], () => {
  const [from, to] = widest(state);
  state.moved = Math.max(Math.abs(state.t0 - from), Math.abs(state.t1 - to)) > (to - from) * 1e-9;
  drawSoon();
});
state.on(['entries', 'filter', 'shown'], () => {
  chooseLanes(state);
  app.channels.update();
  rebuild();
});
state.on(['entries'], () => {
  app.verify(state.entries.filter(({ checked, recording }) => checked === undefined && recording.closed && recording.size <= SMALL));
});
state.on(['start', 'stop'], () => {
  if (state.moved) setView(state, state.t0, state.t1);
  else showAll(state);
});
state.on(['align'], () => {
  state.set(timeLine(state.entries, state.align));
  app.signals.forget(); // what differs between files is another
  collectMarks(state);
  drawSoon();
});
state.on(['entries', 'marks', 'start', 'stop'], () => {
  collectMarks(state);
  drawSoon();
});
state.on(['entries', 'facts', 'mode', 'pairs', 'bands', 'deadband', 'knots', 'fit', 'selecting', 'align', 'theme', 'side', 'marks'], () => app.head.update());
state.on(['mode', 'pairs', 'bands'], rebuild);
state.on(['mode', 'focus'], () => app.channels.update());
state.on(['deadband', 'knots', 'fit', 'focus', 'signals', 'a', 'b', 'tab', 'dock', 'dockHeight', 'facts'], drawSoon);
state.on(['a', 'b'], () => state.dock === null && isOpen(state) && state.set({ dock: true }));
state.on(['hover'], hoverSoon);
state.on(['failures', 'pending', 'progress'], () => {
  showFailures();
  showEmpty();
});
state.on(['side'], () => document.body.classList.toggle('no-side', !state.side));
state.on(['theme'], () => {
  app.channels.update();
  rebuild();
});
app.selection.onChange(drawSoon);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => state.tell(new Set(['theme'])));
new ResizeObserver(drawSoon).observe(at('panels'));
at('panels').addEventListener('scroll', drawSoon);
listenToKeys(app);
acceptDrops(app);

applyTheme(state.theme);
document.body.classList.toggle('no-side', !state.side);
app.head.update();
showEmpty();
drawSoon();

// The files of the page, then what the URL says of them.
async function start() {
  await Promise.all(listSources().map((source) => addRecording(state, source)));
  showHash();
  app.ready = true;
  writeHash(app, fixed);
  window.addEventListener('hashchange', () => {
    state.set({ ...fixed, a: null, b: null, focus: null, ...readHash() });
    showHash();
  });
}

function showHash() {
  const { view, selection, channels } = readHashOfFiles();
  if (channels !== null) {
    applyChannels(state.entries, channels);
    state.tell(new Set(['shown']));
  }
  if (view) setView(state, ...view);
  else showAll(state);
  if (selection) app.selection.set(...selection);
}

// For tests and figures.
window.hapf = {
  app, state, frames,
  get recordings() {
    return state.entries.map(({ recording }) => recording);
  },
  get view() {
    return { t0: state.t0, t1: state.t1 };
  },
  get idle() {
    return !app.signals.busy && !state.pending && state.entries.every(({ checked }) => checked !== 'checking');
  },
  stats: () => Promise.all(state.entries.map(({ recording }) => recording.stats())),
  ready: start(),
};
