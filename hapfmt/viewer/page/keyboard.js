// The keys of the page and the help that lists them.
import { element } from './dom.js';
import { pan, setView, showAll, showSpan, zoom } from './view.js';
import { markText } from './flags.js';
import { goToMark, nextMark } from './marks.js';

const NEAR = 0.1; // of the view

const GROUPS = [
  ['Move', [
    [['ArrowLeft'], 'Move left; with Shift, by a whole view', (app, event) => panBy(app, event.shiftKey ? -1 : -NEAR)],
    [['ArrowRight'], 'Move right; with Shift, by a whole view', (app, event) => panBy(app, event.shiftKey ? 1 : NEAR)],
    [['+', '='], 'Zoom in at the pointer, or at the middle', (app) => zoom(app.state, 0.7, around(app))],
    [['-', '_'], 'Zoom out', (app) => zoom(app.state, 1 / 0.7, around(app))],
    [['0', 'f'], 'Show all', (app) => showAll(app.state)],
    [['Home'], 'Go to the start', (app) => edge(app, app.state.start, 0)],
    [['End'], 'Go to the end', (app) => edge(app, app.state.stop, 1)],
    [['ArrowUp'], 'Go to the channel above', (app) => app.stepLane(-1)],
    [['ArrowDown'], 'Go to the channel below', (app) => app.stepLane(1)],
    [['PageUp'], 'Scroll up', (app) => app.scrollPanels(-1)],
    [['PageDown'], 'Scroll down', (app) => app.scrollPanels(1)],
  ]],
  ['Cursors and selection', [
    [['a'], 'Place cursor A at the pointer, or in the middle', (app) => app.state.set({ a: here(app) })],
    [['b'], 'Place cursor B', (app) => app.state.set({ b: here(app) })],
    [[','], 'Move the last cursor by a sample to the left; with Shift, by ten', (app, event) => app.stepCursor(event.shiftKey ? -10 : -1)],
    [['.'], 'Move the last cursor by a sample to the right; with Shift, by ten', (app, event) => app.stepCursor(event.shiftKey ? 10 : 1)],
    [['s'], 'Select from cursor A to B, or all in sight', (app) => select(app)],
    [['z'], 'Zoom to the selection, or to the span from A to B', (app) => zoomIn(app)],
    [['x', 'Escape'], 'Remove cursors and selection', (app) => app.clear()],
  ]],
  ['Events and damage', [
    [['n'], 'Go to the next event', (app) => goTo(app, 'event', 1)],
    [['p'], 'Go to the event before', (app) => goTo(app, 'event', -1)],
    [[']'], 'Go to the next damage', (app) => goTo(app, 'damage', 1)],
    [['['], 'Go to the damage before', (app) => goTo(app, 'damage', -1)],
  ]],
  ['Show', [
    [['m'], 'Stack the channels, overlay those of a unit, or map them in colours', (app) => app.toggleMode()],
    [['v'], 'Compare the channels of several files', (app) => app.toggle('pairs')],
    [['1'], 'Show the signal', (app) => app.toggleBand('sum')],
    [['2'], 'Show the LF band', (app) => app.toggleBand('lf')],
    [['3'], 'Show the HF band', (app) => app.toggleBand('hf')],
    [['d'], 'Show the error bound', (app) => app.toggle('deadband')],
    [['k'], 'Show the knots', (app) => app.toggle('knots')],
    [['y'], 'Scale to what is in sight, or to the whole recording', (app) => app.toggleFit()],
    [['e'], 'Align several files by epoch, or by their starts', (app) => app.toggleAlign()],
    [['t'], 'Light or dark', (app) => app.toggleTheme()],
    [['/'], 'Filter the channels', (app) => app.focusFilter()],
    [['c'], 'Show or hide the list of channels', (app) => app.toggle('side')],
    [['i'], 'Show or hide the details', (app) => app.toggle('dock')],
    [['o'], 'Open files', (app) => app.chooseFiles()],
    [['?'], 'Show these keys', (app) => app.help.open()],
  ]],
];

// Keys whose names differ with Shift.
const SHIFTED = { '<': ',', '>': '.', ';': ',', ':': '.' };
const NAMES = { ArrowLeft: '←', ArrowRight: '→', ArrowUp: '↑', ArrowDown: '↓', PageUp: 'Page ↑', PageDown: 'Page ↓', Escape: 'Esc', '-': '−' };

const POINTER = [
  ['Wheel', 'Zoom at the pointer'],
  ['Drag', 'Move in time, and through the channels'],
  ['Shift and wheel', 'Move in time'],
  ['Shift and drag', 'Select a span of time'],
  ['Click', 'Place cursor A, then B'],
  ['Double click', 'Show all'],
  ['Wheel on the values', 'Scroll through the channels'],
  ['Two fingers', 'Zoom and move'],
];

function around({ state }) {
  return state.hover ?? state.a ?? (state.t0 + state.t1) / 2;
}

function here({ state }) {
  return state.hover ?? (state.t0 + state.t1) / 2;
}

function panBy({ state }, share) {
  pan(state, share * (state.t1 - state.t0));
}

function edge({ state }, time, share) {
  const span = state.t1 - state.t0;
  setView(state, time - span * (share ? 0.95 : 0.05), time + span * (share ? 0.05 : 0.95));
}

function select({ state, selection }) {
  if (state.a !== null && state.b !== null && state.a !== state.b) selection.set(state.a, state.b);
  else selection.set(Math.max(state.start, state.t0), Math.min(state.stop, state.t1));
}

function zoomIn({ state, selection }) {
  if (selection.range) showSpan(state, ...selection.range);
  else if (state.a !== null && state.b !== null) showSpan(state, Math.min(state.a, state.b), Math.max(state.a, state.b));
}

function goTo(app, kind, direction) {
  const mark = nextMark(app.state, kind, direction);
  if (mark) goToMark(app, mark);
  app.say(mark ? markText(mark) : `No ${kind} ${direction > 0 ? 'after' : 'before'} this place.`);
}

export function listenToKeys(app) {
  const actions = new Map(GROUPS.flatMap(([, keys]) => keys.flatMap(([names, , run]) => names.map((name) => [name, run]))));
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || app.help.isOpen) return;
    const { target } = event;
    if (target.matches('input, textarea, select')) {
      if (event.key !== 'Escape') return;
      event.preventDefault(); // a search field would clear itself and say nothing
      target.blur();
      return;
    }
    const run = actions.get(SHIFTED[event.key] ?? event.key) ?? actions.get(event.key.toLowerCase());
    if (!run) return;
    event.preventDefault();
    run(app, event);
  });
}

export class Help {
  constructor() {
    const rows = (list) => list.flatMap(([keys, text]) => [element('dt', {}, ...keys), element('dd', {}, text)]);
    const named = (names) => names.flatMap((name, i) => [i ? ' ' : '', element('kbd', {}, NAMES[name] ?? name)]);
    const part = (title, list) => element('section', {}, element('h3', {}, title), element('dl', {}, ...rows(list)));
    this.dialog = element('dialog', { id: 'help', 'aria-labelledby': 'help-title' },
      element('form', { method: 'dialog' }, element('h2', { id: 'help-title' }, 'Keys and pointer'), element('button', { autofocus: true }, 'Close')),
      element('div', { class: 'help-parts' },
        ...GROUPS.map(([title, keys]) => part(title, keys.map(([names, text]) => [named(names), text]))),
        part('Pointer', POINTER.map(([name, text]) => [[name], text]))));
    this.dialog.addEventListener('click', (event) => event.target === this.dialog && this.dialog.close());
    this.dialog.addEventListener('keydown', (event) => event.key === '?' && this.dialog.close());
    document.body.append(this.dialog);
  }

  get isOpen() {
    return this.dialog.open;
  }

  open() {
    this.dialog.showModal();
  }
}
