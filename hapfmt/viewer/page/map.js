// The channels of a unit over time in colours: a row for each channel, 20 to 2000 at once.
import { layout, RIGHT } from './chart.js';
import { element, setText } from './dom.js';
import { formatValue } from './format.js';
import { concerns, spanOf } from './marks.js';
import { mapping, rangeInSight } from './paint.js';
import { inSight } from './signals.js';
import { PIXELS, colorAt } from './spectrogram.js';
import { hatch, theme } from './theme.js';

const EDGE = 3; // px above and below
const NAME = 12; // px between names

export class MapChart {
  constructor(state, signals, group, parent) {
    Object.assign(this, { state, signals, group });
    this.canvas = element('canvas', { class: 'map' });
    this.plot = { ctx: this.canvas.getContext('2d') };
    this.picture = document.createElement('canvas');
    this.ends = [element('span'), element('span')];
    const stops = [0, 0.25, 0.5, 0.75, 1].map((share) => `rgb(${colorAt(share)})`);
    const bar = element('span', { class: 'colors', 'aria-hidden': 'true' });
    bar.style.background = `linear-gradient(90deg, ${stops.join()})`;
    this.legend = element('span', { class: 'map-legend' }, `${group.lanes.length} channels`, this.ends[0], bar, this.ends[1], group.unit);
    parent.append(this.canvas);
  }

  resize(width, height) {
    const [wide, high] = [width, height].map((size) => Math.round(size * devicePixelRatio));
    if (this.canvas.width === wide && this.canvas.height === high) return;
    Object.assign(this.canvas, { width: wide, height: high });
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
  }

  destroy() {
    this.canvas.remove();
  }

  resultOf(lane) {
    return this.signals.get(lane, this.state.bands.find((band) => lane.channel.bands.includes(band)) ?? 'sum');
  }

  get box() {
    const { width, height } = this.canvas;
    const ratio = devicePixelRatio;
    const { t0, t1 } = this.state;
    return { left: layout.gutter * ratio, top: EDGE * ratio, width: width - (layout.gutter + RIGHT) * ratio, height: height - 2 * EDGE * ratio, t0, t1, low: 0, high: 1 };
  }

  draw() {
    const { group: { lanes }, plot: { ctx }, picture, box, state } = this;
    ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (box.width < 1 || box.height < 1) return;
    this.paint(Math.floor(box.width));
    const high = box.height / lanes.length;
    ctx.imageSmoothingEnabled = high < 1; // several channels share a pixel
    ctx.drawImage(picture, box.left, box.top, box.width, box.height);
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.left, box.top, box.width, box.height);
    ctx.clip();
    ctx.fillStyle = hatch(ctx, theme.colors.damage, false);
    const { x } = mapping(box);
    for (const mark of state.marks.damage.list) {
      const [from, to] = spanOf(mark).map(x);
      lanes.forEach((lane, i) => concerns(mark, lane) && ctx.fillRect(from, box.top + i * high, Math.max(1, to - from), high));
    }
    const focus = lanes.findIndex(({ key }) => key === state.focus);
    Object.assign(ctx, { strokeStyle: theme.colors.ink, lineWidth: devicePixelRatio });
    if (focus >= 0) ctx.strokeRect(box.left, box.top + focus * high, box.width, Math.max(1, high));
    ctx.restore();
    const every = Math.ceil((NAME * devicePixelRatio) / high);
    Object.assign(ctx, { fillStyle: theme.colors.muted, font: `${11 * devicePixelRatio}px system-ui, sans-serif`, textAlign: 'right', textBaseline: 'middle' });
    for (let i = 0; i < lanes.length; i += every) ctx.fillText(lanes[i].name, box.left - 6 * devicePixelRatio, Math.max(NAME / 2 * devicePixelRatio, box.top + (i + 0.5) * high), box.left - 8 * devicePixelRatio);
  }

  // A pixel for each channel and column; lanes of equal times share the places of their columns.
  paint(columns) {
    const { group: { lanes }, picture, state } = this;
    const whole = state.fit === 'all';
    let [low, high] = [Infinity, -Infinity];
    for (const lane of lanes) {
      const result = (whole && this.signals.getWhole(lane, 'sum')) || this.resultOf(lane);
      const range = result && rangeInSight(result, ...(whole ? [-Infinity, Infinity] : [state.t0 - lane.entry.offset, state.t1 - lane.entry.offset]));
      if (range) [low, high] = [Math.min(low, range[0]), Math.max(high, range[1])];
    }
    setText(this.ends[0], formatValue(Number(low.toPrecision(3))));
    setText(this.ends[1], formatValue(Number(high.toPrecision(3))));
    Object.assign(picture, { width: columns, height: lanes.length });
    const context = picture.getContext('2d');
    const image = context.createImageData(columns, lanes.length);
    const pixels = new Uint32Array(image.data.buffer);
    const scale = high > low ? (PIXELS.length - 1) / (high - low) : 0;
    let places = null;
    lanes.forEach((lane, row) => {
      const result = this.resultOf(lane);
      if (!result?.time.length) return;
      const { time, min, max } = result;
      if (!places || places.lane.entry !== lane.entry || places.time.length !== time.length || places.time[0] !== time[0]) {
        places = { lane, time, of: this.placesOf(time, lane, columns) };
      }
      for (let column = 0; column < columns; column++) {
        const k = places.of[column];
        const value = k < 0 ? NaN : (min[k] + max[k]) / 2;
        if (value === value) pixels[row * columns + column] = PIXELS[Math.round((value - low) * scale)];
      }
    });
    context.putImageData(image, 0, 0);
  }

  // For each column the bin or sample at its time; -1 before the first and after the last.
  placesOf(time, { entry, rate }, columns) {
    const { t0, t1 } = this.state;
    const [from, to] = inSight(time, t0 - entry.offset, t1 - entry.offset);
    const bin = time.length > 1 ? (time[time.length - 1] - time[0]) / (time.length - 1) : 1 / rate;
    const found = new Int32Array(columns).fill(-1);
    let k = from;
    for (let column = 0; column < columns; column++) {
      const at = t0 + ((column + 0.5) / columns) * (t1 - t0) - entry.offset;
      while (k + 1 < to && time[k + 1] - bin / 2 <= at) k++;
      if (Math.abs(time[k] - at) <= bin) found[column] = k;
    }
    return found;
  }

  laneAt(y) {
    const { lanes } = this.group;
    const share = (y * devicePixelRatio - this.box.top) / this.box.height;
    return lanes[Math.floor(share * lanes.length)] ?? null;
  }
}
