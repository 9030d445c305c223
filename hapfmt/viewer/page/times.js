// The one axis of time below the charts: seconds, and numbers of samples where single ones are seen.
import { element } from './dom.js';
import { layout, RIGHT, timeTicks } from './chart.js';
import { formatTime, ticksBetween } from './format.js';
import { theme } from './theme.js';

const FONT = '11px system-ui, sans-serif';
const HEIGHT = 34; // px
const UNIT = 66; // px that the unit takes
const SAMPLE_SPACE = 5; // px between samples whose numbers are shown

export class TimeAxis {
  constructor(state, panels, root) {
    Object.assign(this, { state, panels });
    this.unit = element('span', { class: 'axis-unit' });
    root.append(this.unit);
    const line = { stroke: () => theme.colors.grid, width: 1 };
    const fraction = (time) => (time - state.t0) / (state.t1 - state.t0);
    this.plot = new uPlot({
      width: 300,
      height: HEIGHT,
      padding: [0, RIGHT, 0, () => layout.gutter],
      legend: { show: false },
      cursor: { show: false },
      select: { show: false },
      scales: { x: { time: false, auto: false, range: () => [0, 1] } },
      series: [{}],
      axes: [{
        size: HEIGHT - 2, font: FONT, gap: 3, lineGap: 1.2, stroke: () => theme.colors.muted, ticks: { ...line, size: 4 }, border: { show: true, ...line }, grid: { show: false },
        splits: () => this.ticks().map(({ time }) => fraction(time)),
        values: () => this.ticks().map(({ text }) => text),
      }],
    }, [[0, 1]], root);
  }

  // The lane whose samples are counted: that in focus, else the first in sight.
  counted() {
    const { state, panels } = this;
    const lane = state.lanes.find(({ key }) => key === state.focus) ?? panels.visibleLanes[0];
    const count = lane ? (state.t1 - state.t0) * lane.rate : Infinity;
    return count * SAMPLE_SPACE <= panels.plotWidth ? lane : null;
  }

  ticks() {
    const { state, panels } = this;
    const lane = this.counted();
    if (!state.entries.length) return [];
    const { values, decimals, largest } = timeTicks(state, panels.plotWidth);
    if (!lane) return values.map((time) => ({ time, text: formatTime(time, decimals, largest) }));
    const { rate, entry: { offset } } = lane;
    const [first, last] = [(state.t0 - offset) * rate, (state.t1 - offset) * rate];
    const most = Math.max(2, Math.floor(panels.plotWidth / 110));
    const { step, values: numbers } = ticksBetween(first, last, Math.min(most, Math.max(1, Math.floor(last - first))));
    const digits = Math.min(12, Math.max(decimals, Math.ceil(Math.log10(rate / Math.max(1, step))) + 1));
    const ticks = numbers.filter(Number.isInteger).map((number) => {
      const time = number / rate + offset;
      return { time, text: `${formatTime(time, digits, largest)}\n#${number}` };
    });
    return ticks.filter(({ time, text }) => this.fits(panels.xOf(time), text));
  }

  // Whether a label is on the page as a whole, and right of what its numbers are.
  fits(x, text) {
    const { ctx } = this.plot;
    ctx.font = FONT; // of the page's pixels, so is x
    const half = Math.max(...text.split('\n').map((line) => ctx.measureText(line).width)) / 2;
    return x - half >= UNIT && x + half <= this.panels.width;
  }

  draw() {
    const { width } = this.panels;
    if (this.plot.width !== width) this.plot.setSize({ width, height: HEIGHT });
    this.plot.batch(() => this.plot.redraw(true, true));
    const largest = Math.max(Math.abs(this.state.t0), Math.abs(this.state.t1));
    const seconds = largest >= 120 ? 'min:s' : 's';
    this.unit.hidden = !this.state.entries.length;
    this.unit.textContent = this.counted() ? `${seconds}\n# sample` : seconds;
  }
}
