// The charts below one another. Only those in sight exist.
import { element, setText } from './dom.js';
import { Chart, GUTTER, RIGHT } from './chart.js';
import { DISTINCT, colorOfChannel, dashOfChannel } from './theme.js';

const TITLE = 18; // px
const LEAST = { stacked: 92, overlaid: 180 };

// One group a panel: stacked, each lane; overlaid, the lanes of a unit, as many as colours and dashes tell apart.
export function groupsOf(lanes, mode) {
  if (mode === 'stacked') return lanes.map((lane) => ({ key: lane.key, unit: lane.unit, lanes: [lane] }));
  const groups = new Map();
  for (const lane of lanes) {
    const key = `${Math.floor(lane.color / DISTINCT)} ${lane.unit}`;
    if (!groups.has(key)) groups.set(key, { key: `unit ${key}`, unit: lane.unit, lanes: [] });
    groups.get(key).lanes.push(lane);
  }
  return [...groups.values()];
}

export class Panels {
  constructor(state, signals, root) {
    Object.assign(this, { state, signals, root });
    this.inner = element('div', { id: 'panels-inner' });
    this.empty = element('div', { id: 'empty' });
    root.append(this.inner, this.empty);
    this.groups = [];
    this.open = new Map(); // group key -> { group, element, title, chart }
  }

  // After a change of lanes, mode or bands.
  build() {
    for (const key of [...this.open.keys()]) this.close(key);
    this.groups = groupsOf(this.state.lanes, this.state.mode);
  }

  close(key) {
    const panel = this.open.get(key);
    panel.chart.destroy();
    panel.element.remove();
    this.open.delete(key);
  }

  get width() {
    return Math.max(120, this.root.clientWidth);
  }

  get plotWidth() {
    return Math.max(1, this.width - GUTTER - RIGHT);
  }

  get rowHeight() {
    const least = LEAST[this.state.mode];
    return Math.max(least, Math.floor(this.root.clientHeight / Math.max(1, this.groups.length)));
  }

  get visibleGroups() {
    const { rowHeight, root } = this;
    const first = Math.max(0, Math.floor(root.scrollTop / rowHeight));
    return this.groups.slice(first, Math.ceil((root.scrollTop + root.clientHeight) / rowHeight));
  }

  get visibleLanes() {
    return this.visibleGroups.flatMap(({ lanes }) => lanes);
  }

  draw() {
    const { rowHeight, width } = this;
    this.inner.style.height = `${this.groups.length * rowHeight}px`;
    const visible = this.visibleGroups;
    const keys = new Set(visible.map(({ key }) => key));
    for (const key of [...this.open.keys()]) if (!keys.has(key)) this.close(key);
    const first = this.groups.indexOf(visible[0]);
    visible.forEach((group, i) => {
      const panel = this.open.get(group.key) ?? this.create(group);
      panel.element.style.transform = `translateY(${(first + i) * rowHeight}px)`;
      panel.element.style.height = `${rowHeight}px`;
      panel.element.classList.toggle('focus', group.lanes.some(({ key }) => key === this.state.focus));
      panel.chart.resize(width, rowHeight - TITLE);
      panel.chart.draw();
      setText(panel.note, this.noteOf(group, panel.chart));
    });
  }

  create(group) {
    const title = element('div', { class: 'title' });
    const holder = element('div', { class: 'panel', role: 'group', 'aria-label': group.lanes.map(({ name }) => name).join(', ') }, title);
    this.inner.append(holder);
    const panel = { group, element: holder, title, readings: new Map() };
    for (const lane of group.lanes) {
      const swatch = element('span', { class: dashOfChannel(lane.color).length ? 'swatch dashed' : 'swatch' });
      swatch.style.backgroundColor = colorOfChannel(lane.color);
      const reading = element('output', { class: 'reading', for: 'panels' });
      title.append(element('span', {
        class: 'name',
        title: laneTitle(lane),
        onmouseenter: () => this.state.mode === 'overlaid' && this.state.set({ focus: lane.key }),
        onmouseleave: () => this.state.mode === 'overlaid' && this.state.set({ focus: null }),
        onclick: () => this.state.set({ focus: lane.key }),
      }, this.state.mode === 'overlaid' ? swatch : '', element('bdi', {}, this.fileOf(lane) + lane.name), reading));
      panel.readings.set(lane.key, reading);
    }
    panel.note = element('span', { class: 'note' });
    title.append(panel.note);
    panel.chart = new Chart(this.state, this.signals, group, holder);
    this.open.set(group.key, panel);
    return panel;
  }

  // Why something of a chart is not drawn, or not yet.
  noteOf({ lanes }, chart) {
    const { state, signals } = this;
    for (const lane of lanes) {
      const found = state.bands.map((band) => signals.get(lane, band)).filter(Boolean);
      const failed = found.find(({ kind }) => kind === 'failed');
      const which = lanes.length > 1 ? `${lane.name}: ` : '';
      if (lane.channel.unsupported) return `${which}this viewer cannot decode it (${lane.channel.unsupported})`;
      if (failed) return `${which}it cannot be read (${failed.message})`;
      if (found.some(({ complete }) => complete === false)) return 'Reading …';
      if (state.deadband && lane.channel.deadband?.vector) return `${which}its error bound is that of a vector of channels, so it has no edges here`;
      if (chart.crowded || (state.knots && signals.get(lane, 'knots')?.kind === 'none')) return 'Zoom in to see the knots.';
    }
    return '';
  }

  fileOf(lane) {
    return this.state.entries.length > 1 ? `${lane.entry.name}: ` : '';
  }

  // text(lane) -> what a lane has at the cursor.
  showReadings(text) {
    for (const { readings, group } of this.open.values()) {
      for (const lane of group.lanes) {
        const output = readings.get(lane.key);
        if (output) setText(output, text(lane));
      }
    }
  }

  scrollTo(lane) {
    const i = this.groups.findIndex(({ lanes }) => lanes.includes(lane));
    if (i < 0) return;
    const top = i * this.rowHeight;
    const { scrollTop, clientHeight } = this.root;
    if (top < scrollTop) this.root.scrollTop = top;
    else if (top + this.rowHeight > scrollTop + clientHeight) this.root.scrollTop = top + this.rowHeight - clientHeight;
  }

  timeAt(clientX) {
    const { left } = this.root.getBoundingClientRect();
    const share = (clientX - left - GUTTER) / this.plotWidth;
    return this.state.t0 + share * (this.state.t1 - this.state.t0);
  }

  xOf(time) {
    return GUTTER + ((time - this.state.t0) / (this.state.t1 - this.state.t0)) * this.plotWidth;
  }
}

export function laneTitle({ name, channel, entry, unit }) {
  const facts = [channel.quantity, channel.axis, channel.group, channel.device].filter(Boolean);
  return [`${name}${unit ? ` (${unit})` : ''}`, ...facts, `${channel.rateText ?? channel.rate} Hz`, channel.bound, entry.name].join(' · ');
}
