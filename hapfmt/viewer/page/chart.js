// One chart of uPlot. Its scales are always 0 to 1: it draws axes, grid and the paths of lanes, and what a hostile
// file says never reaches its own arithmetic.
import { edgesOf } from '../data/knots.js';
import { axisLabels, formatTime, formatValue, decimalsOf, ticksBetween } from './format.js';
import { BANDS, colorOfChannel, dashOfChannel, hatch, theme, versionColor } from './theme.js';
import { bandPath, dotsPath, linePath, mapping, rangeInSight, padded, spansPath, squaresPath } from './paint.js';
import { inSight, lowerBound } from './signals.js';
import { concerns, spanOf } from './marks.js';

export const layout = { gutter: 78 }; // px, left of each chart: its unit and values, or its name
export const RIGHT = 12;

const FONT = '11px system-ui, sans-serif';
const SMALL = '9px system-ui, sans-serif';
const EVENTS_DRAWN = 2000; // in one chart
const KNOT_SPACE = 3; // px between knots, on average
const LINE = 1.2; // px
const FLAT_ROOM = 0.08 / 1.16; // of the scale, beyond the values on each side
const POINT_SPACE = 5; // px between samples that are drawn as points

const unitScale = { time: false, auto: false, range: () => [0, 1] };

export function timeTicks(state, width) {
  const largest = Math.max(Math.abs(state.t0), Math.abs(state.t1));
  const { step, values } = ticksBetween(state.t0, state.t1, Math.max(2, Math.floor(width / 110)), largest >= 120);
  return { step, values, largest, decimals: decimalsOf(step) };
}

export function timeLabels(state, width) {
  const { values, decimals, largest } = timeTicks(state, width);
  return values.map((value) => formatTime(value, decimals, largest));
}

// group: { unit, lanes, flat }; a chart of several lanes has a colour for each, a chart of one a colour for each band.
// A flat one shows only the ends of its scale.
export class Chart {
  constructor(state, signals, group, parent) {
    Object.assign(this, { state, signals, group });
    this.range = [0, 1];
    this.ranged = false;
    this.yLabels = [];
    const grid = { stroke: () => theme.colors.grid, width: 1 };
    const { flat } = group;
    const series = this.layers().map((layer) => this.series(layer));
    this.plot = new uPlot({
      width: 300,
      height: 60,
      padding: flat ? [4, RIGHT, 4, 0] : [5, RIGHT, 5, 0],
      legend: { show: false },
      cursor: { show: false },
      select: { show: false },
      scales: { x: unitScale, y: unitScale },
      series: [{}, ...series],
      axes: [
        { size: 0, ticks: { show: false }, grid, splits: () => this.xSplits(), values: (_, splits) => splits.map(() => null) },
        {
          size: () => layout.gutter - (flat ? 0 : 20), ...(flat ? {} : { labelSize: 20, labelGap: 2, labelFont: FONT, label: group.unit || ' ' }),
          font: flat ? SMALL : FONT, gap: 4, stroke: () => theme.colors.muted, ticks: { ...grid, size: flat ? 0 : 4 }, grid: { ...grid, show: !flat },
          splits: () => this.ySplits(), values: (_, splits) => this.yLabels.slice(0, splits.length),
        },
      ],
      hooks: { drawAxes: [() => this.drawUnder()], draw: [() => this.drawOver()] },
    }, [[0, 1], ...series.map(() => [0, 1])], parent);
  }

  // Lanes and bands, one series each, in the order in which they are drawn.
  layers() {
    const { bands } = this.state;
    if (this.group.difference) return this.group.lanes.map((lane) => ({ lane, band: 'difference' }));
    return this.group.lanes.flatMap((lane) => Object.keys(BANDS)
      .filter((band) => bands.includes(band) && lane.channel.bands.includes(band))
      .map((band) => ({ lane, band })));
  }

  get many() {
    return this.state.mode === 'overlaid' || this.group.paired;
  }

  colorOf({ lane, band }) {
    return colorIn(this.state, lane, band);
  }

  series(layer) {
    const { lane, band } = layer;
    const faded = () => this.state.focus && this.state.mode === 'overlaid' && this.state.focus !== lane.key;
    const made = {
      scale: 'y',
      auto: false,
      width: band === 'lf' && this.many ? 2 : this.group.paired && !lane.twin ? 3 * LINE : LINE, // the first version is seen below the other
      stroke: () => this.colorOf(layer) + (faded() ? '30' : ''),
      fill: () => this.colorOf(layer) + (faded() ? '10' : this.state.mode === 'overlaid' ? 'b0' : 'e0'),
      paths: (plot, i) => this.path(layer, plot.series[i]),
      points: { show: () => this.drawPoints(layer, faded()) },
    };
    return made;
  }

  resize(width, height) {
    if (this.plot.width !== width || this.plot.height !== height) this.plot.setSize({ width, height });
  }

  draw() {
    this.range = this.findRange();
    this.plot.batch(() => this.plot.redraw(true, true));
  }

  destroy() {
    this.plot.destroy();
  }

  findRange() {
    const { state, signals } = this;
    let low = Infinity;
    let high = -Infinity;
    for (const { lane, band } of this.layers()) {
      const result = state.fit === 'all' ? signals.getWhole(lane, band) ?? signals.get(lane, band) : signals.get(lane, band);
      if (!result) continue;
      const { offset } = lane.entry;
      const whole = state.fit === 'all';
      const range = rangeInSight(result, whole ? -Infinity : state.t0 - offset, whole ? Infinity : state.t1 - offset);
      if (range) [low, high] = [Math.min(low, range[0]), Math.max(high, range[1])];
      const edges = range && band === 'sum' && state.deadband && edgesOfResult(lane.channel, result);
      if (edges) [low, high] = [Math.min(low, edges.around(low)[0]), Math.max(high, edges.around(high)[1])];
    }
    this.ranged ||= low <= high;
    return low <= high ? padded([low, high]) : this.range;
  }

  box() {
    const { left, top, width, height } = this.plot.bbox;
    const [low, high] = this.range;
    return { left, top, width, height, low, high, t0: this.state.t0, t1: this.state.t1 };
  }

  xSplits() {
    const { t0, t1 } = this.state;
    return timeTicks(this.state, this.plot.width - layout.gutter).values.map((time) => (time - t0) / (t1 - t0));
  }

  ySplits() {
    if (!this.ranged) return []; // nothing has come yet
    const [low, high] = this.range;
    if (this.group.flat) {
      const room = (high - low) * FLAT_ROOM;
      this.yLabels = [low + room, high - room].map((value) => formatValue(Number(value.toPrecision(3))));
      return [FLAT_ROOM, 1 - FLAT_ROOM];
    }
    const most = Math.max(2, Math.floor(this.plot.height / (this.plot.height > 120 ? 32 : 17)));
    let { step, values } = ticksBetween(low, high, most);
    if (values.length < 2) ({ step, values } = ticksBetween(low, high, 2 * most)); // a scale needs two numbers
    this.yLabels = axisLabels(values, step);
    return values.map((value) => (value - low) / (high - low));
  }

  path({ lane, band }, series) {
    const result = this.signals.get(lane, band);
    if (!result) return null;
    series.dash = this.state.mode === 'overlaid' && result.kind === 'samples' ? dashOfChannel(lane.color) : [];
    const { offset } = lane.entry;
    const { time, min, max, kind } = result;
    const box = this.box();
    const paths = { stroke: null, fill: null, clip: null, flags: 0 };
    const whole = this.signals.getWhole(lane, band);
    if (whole && whole !== result) paths.fill = this.edges(whole, result, box, offset);
    if (kind === 'samples') return { ...paths, stroke: linePath(time, min, box, offset) };
    // Filled only: to stroke thousands of steep edges takes longer than all else.
    const fill = bandPath(time, min, max, box, offset, LINE * devicePixelRatio);
    if (paths.fill) fill.addPath(paths.fill);
    return { ...paths, fill };
  }

  // The coarse picture of what a fine one does not reach yet.
  edges(whole, { time }, box, offset) {
    const path = new Path2D();
    if (!time.length) return path;
    const first = time[0] + offset;
    const last = time[time.length - 1] + offset;
    const { x } = mapping(box);
    for (const [t0, t1] of [[box.t0, Math.min(first, box.t1)], [Math.max(last, box.t0), box.t1]]) {
      if (!(t0 < t1)) continue;
      const part = { ...box, t0, t1, left: x(t0), width: x(t1) - x(t0) };
      if (part.width > 2) path.addPath(bandPath(whole.time, whole.min, whole.max, part, offset, LINE * devicePixelRatio));
    }
    return path;
  }

  // Single samples, where there is room between them.
  drawPoints(layer, faded) {
    const { lane, band } = layer;
    const result = this.signals.get(lane, band);
    if (!result || result.kind !== 'samples' || faded) return false;
    const { offset } = lane.entry;
    const [from, to] = inSight(result.time, this.state.t0 - offset, this.state.t1 - offset);
    const box = this.box();
    if (to - from > box.width / devicePixelRatio / POINT_SPACE) return false;
    const { ctx } = this.plot;
    ctx.save();
    this.clip(box);
    ctx.fillStyle = this.colorOf(layer);
    ctx.fill(dotsPath(result.time, result.min, box, offset, 2.4 * devicePixelRatio));
    ctx.restore();
    return false;
  }

  clip({ left, top, width, height }) {
    const { ctx } = this.plot;
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
  }

  // Below the lines: gaps, damage, deadband.
  drawUnder() {
    const { ctx } = this.plot;
    const { state, signals } = this;
    const box = this.box();
    ctx.save();
    this.clip(box);
    for (const lane of this.group.lanes) {
      const { offset } = lane.entry;
      const result = signals.get(lane, this.layers()[0]?.band ?? 'sum');
      if (result?.gaps?.length && (!this.many || this.group.lanes.length === 1)) {
        ctx.fillStyle = hatch(ctx, theme.colors.gap, true);
        ctx.fill(spansPath(result.gaps, box, offset));
      }
      const sum = state.deadband && !this.group.difference && state.bands.includes('sum') ? signals.get(lane, 'sum') : null; // its bound is that of the full band
      const edges = sum?.time.length ? edgesOfResult(lane.channel, sum) : null;
      if (edges) {
        ctx.fillStyle = this.many ? `${this.colorOf({ lane })}40` : theme.colors.deadband;
        ctx.fill(bandPath(sum.time, edges.lower, edges.upper, box, offset));
      }
    }
    this.drawMarks(ctx, box);
    ctx.restore();
  }

  drawMarks(ctx, box) {
    const { x } = mapping(box);
    const { lanes } = this.group;
    const { event, damage } = this.state.marks;
    for (const mark of damage.list) {
      const [start, stop] = spanOf(mark);
      if (stop < box.t0 || start > box.t1 || !lanes.some((lane) => concerns(mark, lane))) continue;
      const path = spansPath([[start, stop]], box, 0);
      ctx.fillStyle = `${theme.colors.damage}20`;
      ctx.fill(path);
      ctx.fillStyle = hatch(ctx, theme.colors.damage, false);
      ctx.fill(path);
    }
    const first = lowerBound(event.starts, box.t0);
    for (let i = first; i < Math.min(event.starts.length, first + EVENTS_DRAWN) && event.starts[i] <= box.t1; i++) {
      const mark = event.list[i];
      if (!lanes.some((lane) => concerns(mark, lane))) continue;
      const [start, stop] = spanOf(mark);
      ctx.fillStyle = `${theme.colors.event}14`;
      if (stop > start) ctx.fill(spansPath([[start, stop]], box, 0));
      ctx.fillStyle = `${theme.colors.event}70`;
      ctx.fillRect(Math.round(x(start)), box.top, devicePixelRatio, box.height);
    }
  }

  // Above the lines: knots, and why nothing is drawn.
  drawOver() {
    const { ctx } = this.plot;
    const { state, signals } = this;
    const box = this.box();
    this.crowded = false; // knots too close to one another to be drawn
    ctx.save();
    this.clip(box);
    if (state.knots && !this.group.difference) {
      for (const lane of this.group.lanes) {
        const knots = signals.get(lane, 'knots');
        if (!knots?.value?.length) continue;
        const [from, to] = inSight(knots.time, state.t0 - lane.entry.offset, state.t1 - lane.entry.offset);
        if (to - from > box.width / devicePixelRatio / KNOT_SPACE) {
          this.crowded = true;
          continue;
        }
        const path = squaresPath(knots.time, knots.value, box, lane.entry.offset, 6 * devicePixelRatio);
        ctx.fillStyle = theme.colors.ground;
        ctx.fill(path);
        ctx.lineWidth = 1.4 * devicePixelRatio;
        ctx.setLineDash([]);
        ctx.strokeStyle = this.many ? this.colorOf({ lane }) : theme.colors.lf;
        ctx.stroke(path);
      }
    }
    ctx.restore();
    ctx.setLineDash([]);
  }
}

// The bands of a chart have their colours; the channels of a chart, and the versions of a channel, have theirs.
export function colorIn({ mode }, lane, band) {
  if (mode === 'overlaid') return colorOfChannel(lane.color);
  return lane.twin ? versionColor(theme.colors[band] ?? theme.colors.sum) : theme.colors[band];
}

// How far from what is drawn the deadband lets the source be; null without one for this channel alone.
function edgesOfResult({ deadband }, result) {
  if (!deadband || deadband.vector) return null;
  if (!result.edges) {
    const contract = { ...deadband, vector: false, floors: [deadband.floor], zeros: [deadband.zero] };
    const edge = (values, side) => Float64Array.from(values, (value) => edgesOf(contract, 0, value)[side]);
    result.edges = { lower: edge(result.min, 0), upper: edge(result.max, 1), around: (value) => edgesOf(contract, 0, value) };
  }
  return result.edges;
}
