// The list of channels: which are shown, a filter by text.
import { element, setText, widestOf } from './dom.js';
import { Rows } from './rows.js';
import { colorIn } from './chart.js';
import { laneTitle, swatchOf } from './panels.js';

// Each word of the filter is in the label, unit, group, device, quantity or file name.
export function matches(lane, filter) {
  return filter.toLowerCase().split(/\s+/).every((word) => lane.text.includes(word));
}

// The lanes of a chart of one unit get their colours in their order, whichever of them are shown.
export function chooseLanes(state) {
  const lanes = state.entries.flatMap((entry) => entry.lanes);
  const counts = new Map();
  for (const lane of lanes) {
    lane.color = counts.get(lane.unit) ?? 0;
    counts.set(lane.unit, lane.color + 1);
  }
  // All numbers of a unit have the decimals of its finest channel.
  const steps = new Map();
  for (const { unit, channel: { step } } of lanes) if (step) steps.set(unit, Math.min(step, steps.get(unit) ?? step));
  for (const lane of lanes) lane.step = steps.get(lane.unit) ?? null;
  // Versions of one recording: channels of one name, unit and rate in several files.
  const firsts = new Map();
  const numbers = new Map();
  for (const lane of lanes) {
    const key = `${lane.unit} ${lane.rate} ${lane.name}`;
    const own = `${lane.entry.number} ${key}`;
    const number = numbers.get(own) ?? 0;
    numbers.set(own, number + 1);
    const first = firsts.get(`${number} ${key}`);
    lane.twin = first ?? null;
    if (!first) firsts.set(`${number} ${key}`, lane);
  }
  state.matching = lanes.filter((lane) => matches(lane, state.filter));
  state.lanes = state.matching.filter(({ shown }) => shown);
}

export class ChannelList {
  constructor(app, root) {
    const { state } = app;
    Object.assign(this, { app, state, root });
    this.input = element('input', {
      type: 'search', id: 'filter', placeholder: 'Filter channels', 'aria-label': 'Filter channels by text', autocomplete: 'off', spellcheck: 'false',
      oninput: () => state.set({ filter: this.input.value }),
    });
    const button = (text, shown) => element('button', { type: 'button', onclick: () => this.showAll(shown) }, text);
    this.count = element('span', { class: 'count' });
    this.rows = new Rows({
      label: 'Channels',
      render: (i, row) => this.render(this.items[i], row),
      act: (i, event) => this.act(this.items[i], event),
      toggle: (i) => this.toggle(this.items[i]),
    });
    this.rows.element.setAttribute('aria-multiselectable', 'true');
    root.append(this.input, element('div', { class: 'bar' }, this.count, button('All', true), button('None', false)), this.rows.element);
    this.items = [];
  }

  update() {
    const { state } = this;
    if (this.input.value !== state.filter) this.input.value = state.filter;
    const many = state.entries.length > 1;
    this.items = [];
    for (const lane of state.matching) {
      if (many && this.items[this.items.length - 1]?.lane?.entry !== lane.entry) this.items.push({ entry: lane.entry });
      this.items.push({ lane });
    }
    const wide = Math.round(widestOf(state.matching.map(({ name, unit }) => `${name} ${unit}`), '13px system-ui, sans-serif')) + 56;
    this.root.style.setProperty('--side', `${Math.max(218, Math.min(300, wide))}px`);
    setText(this.count, `${state.lanes.length} of ${state.entries.reduce((sum, { lanes }) => sum + lanes.length, 0)}`);
    this.rows.empty = state.entries.length ? 'No channel matches the filter.' : '';
    this.rows.setCount(this.items.length);
  }

  render({ lane, entry }, row) {
    if (entry) {
      row.classList.add('file');
      row.append(element('bdi', {}, entry.name));
      return;
    }
    const { state } = this;
    row.setAttribute('aria-selected', String(lane.shown));
    row.title = laneTitle(lane);
    row.classList.toggle('focus', lane.key === state.focus);
    const box = element('span', { class: 'box', 'aria-hidden': 'true' });
    const swatch = state.mode === 'overlaid' ? swatchOf(lane, colorIn(state, lane, 'sum')) : '';
    row.append(box, swatch, element('bdi', { class: 'label' }, lane.name), element('span', { class: 'unit' }, lane.unit));
  }

  // The box shows or hides; the name goes there; Alt shows this one alone.
  act(item, event) {
    const lanes = item.lane ? [item.lane] : item.entry.lanes;
    if (event.altKey) this.only(lanes);
    else if (!item.lane || event.target?.classList?.contains('box')) this.toggle(item);
    else this.app.focusLane(item.lane);
  }

  toggle({ lane, entry }) {
    const lanes = lane ? [lane] : entry.lanes;
    const shown = !lanes.every((one) => one.shown);
    for (const one of lanes) one.shown = shown;
    this.state.tell(new Set(['shown']));
  }

  only(lanes) {
    for (const entry of this.state.entries) for (const lane of entry.lanes) lane.shown = lanes.includes(lane);
    this.state.tell(new Set(['shown']));
  }

  showAll(shown) {
    for (const lane of this.state.matching) lane.shown = shown;
    this.state.tell(new Set(['shown']));
  }
}
