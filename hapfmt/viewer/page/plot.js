// A small chart on a canvas: two axes, linear or logarithmic, around what a caller draws.
import { element } from './dom.js';
import { axisLabels, ticksBetween } from './format.js';
import { theme } from './theme.js';

const FONT = '11px system-ui, sans-serif';
const MARGIN = { left: 66, right: 12, top: 8, bottom: 32 };

const powers = { '-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹' };

function powerText(power) {
  if (power >= -2 && power <= 4) return String(Number(`1e${power}`));
  return `10${[...String(power)].map((digit) => powers[digit]).join('')}`;
}

// -> [{ at: 0..1, text }] of an axis { low, high, log }.
export function axisTicks({ low, high, log }, most) {
  if (!log) {
    const { step, values } = ticksBetween(low, high, most);
    const texts = axisLabels(values, step);
    return values.map((value, i) => ({ at: (value - low) / (high - low), text: texts[i] }));
  }
  const [first, last] = [Math.log10(low), Math.log10(high)];
  const every = Math.max(1, Math.ceil((last - first) / most));
  const ticks = [];
  for (let power = Math.ceil(first - 1e-9); power <= last + 1e-9; power++) {
    if (power % every === 0) ticks.push({ at: (power - first) / (last - first), text: powerText(power) });
  }
  if (ticks.length > 1) return ticks;
  // Less than two decades: 1, 2 and 5 of each.
  const more = [];
  for (let power = Math.floor(first); power <= Math.ceil(last); power++) {
    for (const digit of [1, 2, 5]) {
      const value = digit * 10 ** power;
      if (value >= low && value <= high) more.push({ at: (Math.log10(value) - first) / (last - first), text: String(Number(value.toPrecision(3))) });
    }
  }
  return more.length > most ? more.filter(({ text }) => /^[0.]*1/.test(text) || more.length < 4) : more;
}

export const shareOf = ({ low, high, log }, value) => (log
  ? (Math.log10(value) - Math.log10(low)) / (Math.log10(high) - Math.log10(low)) : (value - low) / (high - low));

export const valueAt = ({ low, high, log }, share) => (log ? low * (high / low) ** share : low + share * (high - low));

export class Plot {
  // onMove(share of the width or null): the pointer is there, or the arrow keys went there.
  constructor({ label, onMove = () => {} }) {
    this.canvas = element('canvas', { role: 'img', 'aria-label': label, tabindex: '0' });
    this.element = element('div', { class: 'plot' }, this.canvas);
    this.share = null;
    const move = (share) => {
      this.share = share;
      onMove(share);
    };
    this.canvas.addEventListener('pointermove', ({ offsetX }) => {
      const { left, width } = this.box;
      const share = (offsetX - left) / width;
      move(share >= 0 && share <= 1 ? share : null);
    });
    this.canvas.addEventListener('pointerleave', () => move(null));
    this.canvas.addEventListener('keydown', (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
      move(Math.max(0, Math.min(1, (this.share ?? 0.5) + step * (event.shiftKey ? 0.05 : 0.005))));
      event.preventDefault();
      event.stopPropagation();
    });
  }

  get box() {
    const { clientWidth, clientHeight } = this.element;
    const { left, right, top, bottom } = MARGIN;
    return { left, top, width: Math.max(1, clientWidth - left - right), height: Math.max(1, clientHeight - top - bottom) };
  }

  // axes { x, y }: { low, high, log, label }; paint(context, box, toX, toY) draws within them.
  draw({ x, y }, paint) {
    const { canvas, element: { clientWidth, clientHeight }, box } = this;
    const [wide, high] = [clientWidth, clientHeight].map((size) => Math.round(size * devicePixelRatio));
    if (canvas.width !== wide) canvas.width = wide;
    if (canvas.height !== high) canvas.height = high;
    const context = canvas.getContext('2d');
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, clientWidth, clientHeight);
    const { left, top, width, height } = box;
    const toX = (value) => left + shareOf(x, value) * width;
    const toY = (value) => top + (1 - shareOf(y, value)) * height;
    const { grid, muted } = theme.colors;
    Object.assign(context, { font: FONT, fillStyle: muted, strokeStyle: grid, lineWidth: 1, textAlign: 'center', textBaseline: 'top' });
    context.setLineDash([]);
    context.beginPath();
    for (const { at, text } of axisTicks(x, Math.max(2, Math.floor(width / 70)))) {
      const px = Math.round(left + at * width) + 0.5;
      context.moveTo(px, top);
      context.lineTo(px, top + height + 4);
      context.fillText(text, px, top + height + 5);
    }
    Object.assign(context, { textAlign: 'right', textBaseline: 'middle' });
    for (const { at, text } of axisTicks(y, Math.max(2, Math.floor(height / 22)))) {
      const py = Math.round(top + (1 - at) * height) + 0.5;
      context.moveTo(left - 4, py);
      context.lineTo(left + width, py);
      context.fillText(text, left - 7, py);
    }
    context.stroke();
    Object.assign(context, { textAlign: 'right', textBaseline: 'bottom' });
    context.fillText(x.label, left + width, clientHeight - 1);
    context.save();
    context.translate(3, top + height / 2);
    context.rotate(-Math.PI / 2);
    Object.assign(context, { textAlign: 'center', textBaseline: 'top' });
    context.fillText(y.label, 0, 0, height + 16);
    context.restore();
    context.save();
    context.beginPath();
    context.rect(left, top, width, height);
    context.clip();
    paint(context, box, toX, toY);
    if (this.share !== null) {
      context.fillStyle = muted;
      context.fillRect(Math.round(left + this.share * width), top, 1, height);
    }
    context.restore();
  }
}
