// The spectrum of each shown channel, of the selection.
import { eachPart, namedLane, spanFor, spanText } from './chosen.js';
import { element, setText } from './dom.js';
import { formatValue, plural } from './format.js';
import { Plot, valueAt } from './plot.js';
import { colorOfChannel, dashOfChannel } from './theme.js';
import { LENGTHS, SHORTEST, Welch, lengthFor } from './welch.js';
import { Work } from './work.js';

const MOST = 8; // channels, as many as colours tell apart
const FIRST_PEAK = 2; // bin 1 holds what is left of the mean and of slow drift
const DECADES = 8; // below the peak of a line

export const spectrumTab = { id: 'spectrum', title: 'Spectrum', share: 0.4, create: (app) => new Spectrum(app) };

// A choice of the length of a segment; 0: by the number of samples.
export function lengthChoice(onChange) {
  const options = [[0, 'Segments: automatic'], ...LENGTHS.map((length) => [length, `Segments of ${length} samples`])];
  return element('select', { 'aria-label': 'Length of a segment', onchange: onChange }, ...options.map(([value, text]) => element('option', { value }, text)));
}

// The length asked for, no longer than the samples; 0: there are too few.
export function lengthOf(choice, count) {
  if (count < SHORTEST) return 0;
  return Number(choice.value) || lengthFor(count);
}

export const tooShort = (length) => (length ? `No ${length} samples without a gap.` : `Fewer than ${SHORTEST} samples.`);

class Spectrum {
  constructor(app) {
    const { state, readings } = app;
    Object.assign(this, { app, state, readings });
    this.found = new Map(); // lane key -> { lane, result or message }
    this.choice = lengthChoice(() => this.update());
    this.said = element('span', { class: 'said', role: 'status' });
    this.plots = new Map(); // unit -> Plot
    this.share = null; // of the width of every plot, where the mark is
    this.holder = element('div', { class: 'plots' });
    this.legend = element('div', { class: 'legend', tabindex: '0', role: 'region', 'aria-label': 'Channels of the spectrum' });
    this.element = element('div', { class: 'spectrum' },
      element('div', { class: 'bar' }, this.choice, this.said),
      element('div', { class: 'beside' }, this.holder, this.legend));
    this.work = new Work((signal, lanes) => this.compute(signal, lanes), (error) => error && setText(this.said, error.message));
    new ResizeObserver(() => this.draw()).observe(this.holder);
  }

  update() {
    const { state, app } = this;
    const first = state.lanes.slice(0, MOST);
    const focused = state.lanes.find(({ key }) => key === state.focus);
    const lanes = !focused || first.includes(focused) ? first : [...first.slice(0, -1), focused];
    const parts = lanes.map((lane) => `${lane.key} ${this.readings.bandOf(lane)} ${spanFor(app, lane.entry)}`);
    this.work.ask(`${this.choice.value} ${parts.join(';')}`, lanes);
    this.draw();
  }

  explain(text) {
    const { length } = this.state.lanes;
    const more = length > MOST ? ` ${MOST} of ${length} channels; choose others in the list.` : '';
    setText(this.said, `${spanText(this.app)}. ${text}${more}`);
  }

  async compute(signal, lanes) {
    this.found = new Map();
    this.draw();
    for (const [i, lane] of lanes.entries()) {
      this.explain(`Computing, ${i} of ${plural(lanes.length, 'channel')}.`);
      this.found.set(lane.key, { lane, color: i, ...await this.computeOne(signal, lane) });
      this.draw();
    }
    this.explain(lanes.length ? 'Hann windows that overlap by half, without missing samples. The square is the density of hapfmt plot.' : 'No channel is shown.');
  }

  async computeOne(signal, lane) {
    const span = spanFor(this.app, lane.entry);
    if (!span) return { message: 'nothing here' };
    const length = lengthOf(this.choice, Math.round((span[1] - span[0]) * lane.rate));
    if (!length) return { message: tooShort(length) };
    const welch = new Welch(length, lane.rate);
    try {
      await eachPart(lane, span, this.readings.bandOf(lane), signal, ({ value }) => welch.push(value));
    } catch (error) {
      if (signal.aborted) throw error;
      return { message: error.message };
    }
    const result = welch.result();
    if (!result) return { message: tooShort(length) };
    const amplitude = result.density.map(Math.sqrt);
    let peak = Math.min(FIRST_PEAK, amplitude.length - 1);
    for (let k = peak + 1; k < amplitude.length; k++) if (amplitude[k] > amplitude[peak]) peak = k;
    return { ...result, amplitude, peak };
  }

  // One axis of frequency for all lines; null without any.
  frequencies(lines) {
    if (!lines.length) return null;
    const low = Math.min(...lines.map(({ frequency }) => frequency[1]));
    return { low, high: Math.max(...lines.map(({ frequency }) => frequency[frequency.length - 1])), log: true, label: 'Hz' };
  }

  // The axis of the lines of a unit.
  densities(lines, unit) {
    let [least, most] = [Infinity, 0];
    for (const { amplitude, peak } of lines) {
      const floor = amplitude[peak] / 10 ** DECADES;
      for (let k = 1; k < amplitude.length; k++) {
        most = Math.max(most, amplitude[k]);
        if (amplitude[k] > 0) least = Math.min(least, Math.max(floor, amplitude[k]));
      }
    }
    if (!(most > 0)) [least, most] = [0.1, 1];
    return { low: least / 1.5, high: most * 1.5, log: true, label: `${unit || '1'}/√Hz` };
  }

  draw() {
    const lines = [...this.found.values()].filter(({ amplitude }) => amplitude);
    const x = this.frequencies(lines);
    const units = [...new Set(lines.map(({ lane }) => lane.unit))];
    for (const unit of units) if (!this.plots.has(unit)) this.plots.set(unit, this.plotOf(unit));
    for (const [unit, plot] of this.plots) {
      plot.element.hidden = !units.includes(unit);
      if (plot.element.hidden || !plot.element.clientHeight) continue;
      const own = lines.filter(({ lane }) => lane.unit === unit);
      plot.share = this.share;
      plot.draw({ x, y: this.densities(own, unit) }, (context, box, toX, toY) => this.paint(own, context, toX, toY));
    }
    this.showLegend(x);
  }

  plotOf(unit) {
    const plot = new Plot({
      label: `Spectrum: amplitude density in ${unit || '1'}/√Hz by frequency. The arrow keys move the mark.`,
      onMove: (share) => {
        this.share = share;
        this.draw();
      },
    });
    this.holder.append(plot.element);
    return plot;
  }

  paint(lines, context, toX, toY) {
    for (const { lane, color, frequency, amplitude } of lines) {
      context.strokeStyle = colorOfChannel(color);
      context.lineWidth = lane.key === this.state.focus ? 2.4 : 1.3;
      context.setLineDash(dashOfChannel(color));
      context.beginPath();
      for (let k = 1; k < frequency.length; k++) {
        const y = amplitude[k] > 0 ? toY(amplitude[k]) : 1e5;
        if (k === 1) context.moveTo(toX(frequency[k]), y);
        else context.lineTo(toX(frequency[k]), y);
      }
      context.stroke();
    }
    context.setLineDash([]);
  }

  showLegend(x) {
    const mark = x && this.share !== null ? valueAt(x, this.share) : null;
    this.legend.replaceChildren(...[...this.found.values()].map(({ lane, color, message, frequency, amplitude, peak }) => {
      let text = message;
      if (amplitude) {
        const k = mark === null ? peak : Math.max(1, Math.min(amplitude.length - 1, Math.round(mark / frequency[1])));
        text = `${mark === null ? 'peak ' : ''}${formatValue(Number(amplitude[k].toPrecision(4)))} ${lane.unit || '1'}/√Hz at ${formatValue(Number(frequency[k].toPrecision(5)))} Hz`;
      }
      const swatch = element('span', { class: dashOfChannel(color).length ? 'swatch dashed' : 'swatch', 'aria-hidden': 'true' });
      swatch.style.backgroundColor = colorOfChannel(color);
      return element('p', { dataset: { lane: lane.key } }, swatch, element('bdi', {}, namedLane(this.app, lane)), element('span', { class: 'said' }, text));
    }));
  }
}
