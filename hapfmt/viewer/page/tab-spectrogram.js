// The spectrogram of the channel in focus, of the selection.
import { eachPart, laneInFocus, namedLane, spanFor, spanText } from './chosen.js';
import { element, setText } from './dom.js';
import { formatTime, formatValue } from './format.js';
import { Plot, valueAt } from './plot.js';
import { PIXELS, Spectrogram, colorAt } from './spectrogram.js';
import { lengthChoice, tooShort } from './tab-spectrum.js';
import { theme } from './theme.js';
import { SHORTEST, lengthFor } from './welch.js';
import { Work } from './work.js';

const RANGES = [40, 60, 80, 100];
const SCALE = 64; // px of the legend of colours
const CELLS = 2 ** 24;

export const spectrogramTab = { id: 'spectrogram', title: 'Spectrogram', share: 0.4, create: (app) => new SpectrogramTab(app) };

// A choice of the channel in focus.
export function laneChoice(app) {
  const choice = element('select', {
    'aria-label': 'Channel', onchange: () => app.focusLane(app.state.lanes.find(({ key }) => key === choice.value)),
  });
  const update = () => {
    const lanes = app.state.lanes.slice(0, 1000);
    const keys = lanes.map(({ key }) => key).join();
    if (choice.dataset.keys !== keys) choice.replaceChildren(...lanes.map((lane) => element('option', { value: lane.key }, namedLane(app, lane))));
    choice.dataset.keys = keys;
    choice.value = laneInFocus(app)?.key ?? '';
  };
  return { choice, update };
}

class SpectrogramTab {
  constructor(app) {
    const { state, readings } = app;
    Object.assign(this, { app, state, readings, found: null });
    this.lanes = laneChoice(app);
    this.lengths = lengthChoice(() => this.update());
    this.range = element('select', { 'aria-label': 'Range of the colours', onchange: () => this.paint() },
      ...RANGES.map((db) => element('option', { value: db, selected: db === 80 }, `${db} dB`)));
    this.said = element('span', { class: 'said', role: 'status' });
    this.read = element('output', { class: 'said' });
    this.plot = new Plot({ label: 'Spectrogram: density by time and frequency. The arrow keys move the mark.', onMove: () => this.draw() });
    this.scale = element('canvas', { width: 12, height: SCALE, 'aria-hidden': 'true' });
    this.most = element('span');
    this.least = element('span');
    this.legend = element('div', { class: 'scale' }, this.most, this.scale, this.least, element('span', { class: 'said' }));
    this.element = element('div', { class: 'spectrogram' },
      element('div', { class: 'bar' }, this.lanes.choice, this.lengths, this.range, this.said, this.read),
      element('div', { class: 'beside' }, this.plot.element, this.legend));
    this.picture = document.createElement('canvas');
    this.work = new Work((signal, lane) => this.compute(signal, lane), (error) => error && setText(this.said, error.message));
    new ResizeObserver(() => this.draw()).observe(this.plot.element);
  }

  update() {
    this.lanes.update();
    const lane = laneInFocus(this.app);
    const key = lane ? `${lane.key} ${this.readings.bandOf(lane)} ${spanFor(this.app, lane.entry)} ${this.lengths.value} ${this.columns}` : '';
    this.work.ask(key, lane);
    this.draw();
  }

  // A column for two pixels; a little wider charts keep theirs.
  get columns() {
    return Math.max(50, Math.floor(this.plot.box.width / 200) * 100);
  }

  async compute(signal, lane) {
    this.found = null;
    this.draw();
    const span = lane && spanFor(this.app, lane.entry);
    if (!span) {
      setText(this.said, 'No samples are chosen.');
      return;
    }
    const count = Math.round((span[1] - span[0]) * lane.rate);
    // Segments are shorter than those of a spectrum, so that the picture also shows times.
    const length = count < SHORTEST ? 0 : Number(this.lengths.value) || Math.min(1024, lengthFor(count / 8));
    if (!length || count < length) {
      setText(this.said, tooShort(length));
      return;
    }
    const columns = Math.min(this.columns, Math.floor(CELLS / length));
    const grid = new Spectrogram(length, lane.rate, count, columns);
    await eachPart(lane, span, this.readings.bandOf(lane), signal, ({ value }, share) => {
      grid.push(value);
      setText(this.said, `Computing, ${Math.floor(100 * share)} %.`);
    });
    const highest = grid.highest();
    if (!Number.isFinite(highest)) {
      setText(this.said, grid.hits.some(Boolean) ? 'The signal is constant.' : tooShort(length));
      return;
    }
    this.found = { grid, lane, span, top: Math.ceil(highest / 5) * 5 };
    setText(this.said, `${spanText(this.app)}. Segments of ${length} samples.`);
    this.paint();
  }

  // The picture of the densities, a pixel each.
  paint() {
    if (!this.found) return;
    const { grid, top } = this.found;
    const range = Number(this.range.value);
    const { bins } = grid.density;
    Object.assign(this.picture, { width: grid.columns, height: bins });
    const context = this.picture.getContext('2d');
    const image = context.createImageData(grid.columns, bins);
    const pixels = new Uint32Array(image.data.buffer);
    for (let column = 0; column < grid.columns; column++) {
      if (!grid.hits[column]) continue;
      for (let bin = 0; bin < bins; bin++) {
        const share = (grid.level(column, bin) - top + range) / range;
        pixels[(bins - 1 - bin) * grid.columns + column] = PIXELS[Math.round(255 * Math.max(0, Math.min(1, share)))];
      }
    }
    context.putImageData(image, 0, 0);
    const scale = this.scale.getContext('2d');
    for (let y = 0; y < SCALE; y++) {
      scale.fillStyle = `rgb(${colorAt(1 - y / (SCALE - 1))})`;
      scale.fillRect(0, y, 12, 1);
    }
    setText(this.most, `${formatValue(top)} dB`);
    setText(this.least, `${formatValue(top - range)} dB`);
    const { unit } = this.found.lane;
    const square = /^[a-zA-Z]*$/.test(unit) ? `${unit}²` : `(${unit})²`;
    setText(this.legend.lastChild, `re 1 ${unit ? `${square}/Hz` : '/Hz'}`.replace('1 /', '1/'));
    this.draw();
  }

  draw() {
    const { found, plot } = this;
    plot.canvas.hidden = this.legend.hidden = !found;
    setText(this.read, '');
    if (!found || !plot.element.clientHeight) return;
    const { grid, lane, span } = found;
    const { offset } = lane.entry;
    const axes = {
      x: { low: span[0] + offset, high: span[1] + offset, label: 's' },
      y: { low: 0, high: lane.rate / 2, label: 'Hz' },
    };
    plot.draw(axes, (context, { left, top, width, height }) => {
      context.fillStyle = theme.colors.ground;
      context.fillRect(left, top, width, height);
      context.imageSmoothingEnabled = false;
      context.drawImage(this.picture, left, top, width, height);
    });
    if (plot.share !== null) this.showReading(axes);
  }

  // The loudest frequency at the mark.
  showReading({ x }) {
    const { grid } = this.found;
    const column = Math.min(grid.columns - 1, Math.floor(this.plot.share * grid.columns));
    let best = 1;
    for (let bin = 2; bin < grid.density.bins; bin++) if (grid.level(column, bin) > grid.level(column, best)) best = bin;
    const level = grid.level(column, best);
    const time = `${formatTime(valueAt(x, this.plot.share), 3)} s`;
    const hertz = formatValue(Number(((best * grid.density.rate) / grid.density.length).toPrecision(5)));
    setText(this.read, Number.isFinite(level) ? `${time}: peak ${level.toFixed(1).replace('-', '−')} dB at ${hertz} Hz` : `${time}: no segment without a gap`);
  }
}
