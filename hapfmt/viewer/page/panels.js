// The charts below one another. Only those in sight exist.
import { element, setText, widestOf } from './dom.js';
import { Chart, colorIn, layout, RIGHT } from './chart.js';
import { MapChart } from './map.js';
import { DISTINCT, dashOfChannel } from './theme.js';

const TITLE = 18; // px
const LEAST = { stacked: 28, overlaid: 180, map: 120, paired: 44 };
const FLAT = 72; // px of a row that is too low for a line of its own with the name
const ENDS = 46; // px for the ends of a scale
const SCALE = 78; // px of the gutter where the name is above the chart

// One group a panel. Stacked: each lane, or the versions of one channel, and then how they differ. Overlaid: the lanes of
// a unit, as many as colours and dashes tell apart. Map: all lanes of a unit.
export function groupsOf({ lanes, mode, pairs }) {
  if (mode === 'stacked') {
    const shown = new Set(lanes);
    const isTwin = ({ twin }) => pairs && shown.has(twin);
    return lanes.filter((lane) => !isTwin(lane)).flatMap((lane) => {
      const twins = lanes.filter((one) => isTwin(one) && one.twin === lane);
      const own = { key: lane.key, unit: lane.unit, lanes: [lane, ...twins], paired: twins.length > 0 };
      return twins.length ? [own, { ...own, key: `${lane.key} difference`, lanes: twins, difference: true }] : [own];
    });
  }
  const groups = new Map();
  for (const lane of lanes) {
    const key = `${mode} ${mode === 'map' ? 0 : Math.floor(lane.color / DISTINCT)} ${lane.unit}`;
    if (!groups.has(key)) groups.set(key, { key, unit: lane.unit, lanes: [] });
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
    this.longest = 0; // px of the longest name
  }

  // After a change of lanes, mode or bands.
  build() {
    for (const key of [...this.open.keys()]) this.close(key);
    this.groups = groupsOf(this.state);
    this.longest = widestOf(this.state.lanes.map(({ name, unit }) => `${name}  ${unit}`));
    this.arrange();
  }

  // Decides whether the names stay left of the charts, and how much room they take.
  arrange() {
    const { state, rowHeight, width, root } = this;
    const flat = state.mode === 'stacked' && rowHeight < FLAT;
    if (flat !== this.flat) for (const key of [...this.open.keys()]) this.close(key);
    this.flat = flat;
    const wide = Math.max(SCALE, Math.min(this.longest + (flat ? ENDS : 0) + 14, 240, width * 0.4));
    layout.gutter = Math.round(flat || state.mode === 'map' ? wide : SCALE);
    root.closest('#stage').style.setProperty('--gutter', `${layout.gutter}px`);
    root.classList.toggle('flat', flat);
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
    return Math.max(1, this.width - layout.gutter - RIGHT);
  }

  get rowHeight() {
    const least = LEAST[this.groups.some(({ paired }) => paired) ? 'paired' : this.state.mode];
    return Math.max(least, Math.floor(this.root.clientHeight / Math.max(1, this.groups.length)));
  }

  get visibleGroups() {
    const { rowHeight, root } = this;
    const first = Math.max(0, Math.floor(root.scrollTop / rowHeight));
    return this.groups.slice(first, Math.ceil((root.scrollTop + root.clientHeight) / rowHeight));
  }

  get visibleLanes() {
    return [...new Set(this.visibleGroups.flatMap(({ lanes }) => lanes))];
  }

  draw() {
    this.arrange();
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
      panel.chart.resize(width, rowHeight - (this.flat ? 0 : TITLE));
      panel.chart.draw();
      setText(panel.note, this.noteOf(group, panel.chart));
    });
  }

  create(group) {
    const title = element('div', { class: 'title' });
    const holder = element('div', { class: 'panel', role: 'group', 'aria-label': namesOf(group).join(', ') }, title);
    this.inner.append(holder);
    const panel = { group, element: holder, title, readings: new Map() };
    if (group.paired && !group.difference) title.append(element('span', { class: 'name' }, element('bdi', {}, group.lanes[0].name), this.flat ? element('span', { class: 'unit' }, group.unit) : ''));
    if (this.state.mode !== 'map') for (const lane of group.lanes) title.append(this.nameOf(group, lane, panel));
    panel.note = element('span', { class: 'note' });
    panel.chart = this.state.mode === 'map' ? new MapChart(this.state, this.signals, group, holder)
      : new Chart(this.state, this.signals, { ...group, flat: this.flat }, holder);
    title.append(panel.chart.legend ?? '', panel.note);
    this.open.set(group.key, panel);
    return panel;
  }

  // Versions of one channel have the names of their files.
  nameOf({ difference, paired, unit }, lane, panel) {
    const overlaid = this.state.mode === 'overlaid';
    const swatch = overlaid || paired ? swatchOf(lane, colorIn(this.state, lane, 'sum')) : '';
    const reading = element('output', { class: 'reading', for: 'panels' });
    panel.readings.set(lane.key, reading);
    const text = difference ? `${lane.entry.name} − ${lane.twin.entry.name}` : paired ? lane.entry.name : this.fileOf(lane) + lane.name;
    return element('span', {
      class: paired ? 'name version' : 'name',
      title: laneTitle(lane),
      onmouseenter: () => overlaid && this.state.set({ focus: lane.key }),
      onmouseleave: () => overlaid && this.state.set({ focus: null }),
      onclick: () => this.state.set({ focus: lane.key }),
    }, swatch, element('bdi', {}, text), this.flat && !paired ? element('span', { class: 'unit' }, unit) : '', reading);
  }

  // Why something of a chart is not drawn, or not yet.
  noteOf({ lanes, difference }, chart) {
    const { state, signals } = this;
    for (const lane of lanes) {
      const found = (difference ? ['difference'] : state.bands).map((band) => signals.get(lane, band)).filter(Boolean);
      const failed = found.find(({ kind }) => kind === 'failed');
      const which = lanes.length > 1 ? `${lane.name}: ` : '';
      if (lane.channel.unsupported) return `${which}this viewer cannot decode it (${lane.channel.unsupported})`;
      if (failed) return `${which}it cannot be read (${failed.message})`;
      if (difference && found[0]?.kind === 'none') return 'Zoom in to see the difference.';
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
        if (output) setText(output, text(lane, group.difference));
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
    const share = (clientX - left - layout.gutter) / this.plotWidth;
    return this.state.t0 + share * (this.state.t1 - this.state.t0);
  }

  xOf(time) {
    return layout.gutter + ((time - this.state.t0) / (this.state.t1 - this.state.t0)) * this.plotWidth;
  }
}

export function swatchOf({ color }, shade) {
  const swatch = element('span', { class: dashOfChannel(color).length ? 'swatch dashed' : 'swatch', 'aria-hidden': 'true' });
  swatch.style.backgroundColor = shade;
  return swatch;
}

const namesOf = ({ lanes, unit }) => (lanes.length > 40 ? [`${lanes.length} channels`, unit] : lanes.map(({ name }) => name));

export function laneTitle({ name, channel, entry, unit }) {
  const facts = [channel.quantity, channel.axis, channel.group, channel.device].filter(Boolean);
  return [`${name}${unit ? ` (${unit})` : ''}`, ...facts, `${channel.rateText ?? channel.rate} Hz`, channel.bound, entry.name].join(' · ');
}
