// The whole time line in one strip: the channel in focus, marks, and the part in sight, which can be dragged.
import { element, setText } from './dom.js';
import { layout, RIGHT } from './chart.js';
import { bandPath, linePath, padded, rangeInSight, spansPath } from './paint.js';
import { formatTime } from './format.js';
import { spanOf } from './marks.js';
import { hatch, theme } from './theme.js';
import { setView, widest } from './view.js';
import { lowerBound } from './signals.js';

export class Strip {
  constructor(app, root) {
    const { state, panels, signals } = app;
    Object.assign(this, { state, panels, signals, root });
    this.canvas = element('canvas', { 'aria-hidden': 'true' });
    this.window = element('div', {
      class: 'window', role: 'scrollbar', 'aria-controls': 'panels', 'aria-orientation': 'horizontal', 'aria-label': 'Part of the time line in sight',
    });
    this.name = element('bdi', { class: 'strip-name' });
    root.append(this.canvas, this.name, this.window);
    root.addEventListener('pointerdown', (event) => this.grab(event));
  }

  get width() {
    return Math.max(1, this.root.clientWidth - layout.gutter - RIGHT);
  }

  xOf(time) {
    const [start, stop] = widest(this.state);
    return layout.gutter + ((time - start) / (stop - start)) * this.width;
  }

  lane() {
    const { state, panels } = this;
    return state.lanes.find(({ key }) => key === state.focus) ?? panels.visibleLanes[0] ?? null;
  }

  draw() {
    const { state, canvas, signals, root } = this;
    const ratio = devicePixelRatio;
    const [width, height] = [Math.round(root.clientWidth * ratio), Math.round(root.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const ctx = canvas.getContext('2d');
    ctx.clearRect(0, 0, width, height);
    const lane = this.lane();
    this.window.hidden = !state.entries.length;
    setText(this.name, lane?.name ?? '');
    this.name.title = lane ? `The whole time line of ${lane.entry.name}: ${lane.name}` : '';
    if (!state.entries.length) return;
    const [start, stop] = widest(state);
    const box = { left: layout.gutter * ratio, top: 3 * ratio, width: this.width * ratio, height: height - 6 * ratio, t0: start, t1: stop };
    const result = lane && signals.getWhole(lane, 'sum');
    const range = result && rangeInSight(result, -Infinity, Infinity);
    if (range) {
      const [low, high] = padded(range);
      const part = { ...box, low, high };
      const { offset } = lane.entry;
      ctx.fillStyle = hatch(ctx, theme.colors.gap, true);
      ctx.fill(spansPath(result.gaps ?? [], part, offset));
      ctx.strokeStyle = ctx.fillStyle = `${theme.colors.muted}b0`;
      ctx.lineWidth = ratio;
      if (result.kind === 'samples') ctx.stroke(linePath(result.time, result.min, part, offset));
      else ctx.fill(bandPath(result.time, result.min, result.max, part, offset, ratio));
    }
    this.drawMarks(ctx, ratio);
    const [from, to] = [this.xOf(state.t0), this.xOf(state.t1)].map((x) => Math.max(layout.gutter, Math.min(layout.gutter + this.width, x)));
    this.window.style.transform = `translateX(${from}px)`;
    this.window.style.width = `${Math.max(4, to - from)}px`;
    this.window.setAttribute('aria-valuenow', Math.round((100 * (state.t0 - start)) / (stop - start)));
    this.window.setAttribute('aria-valuetext', `${formatTime(state.t0, 3)} to ${formatTime(state.t1, 3)} s`);
  }

  drawMarks(ctx, ratio) {
    const { event, damage } = this.state.marks;
    const height = this.root.clientHeight;
    ctx.fillStyle = theme.colors.damage;
    for (const mark of damage.list) {
      const [from, to] = spanOf(mark).map((time) => this.xOf(time));
      ctx.fillRect(from * ratio, (height - 4) * ratio, Math.max(2, to - from) * ratio, 4 * ratio);
    }
    ctx.fillStyle = theme.colors.event;
    const [start, stop] = widest(this.state);
    const pixel = (stop - start) / this.width;
    for (let i = 0; i < event.starts.length;) {
      ctx.fillRect(this.xOf(event.starts[i]) * ratio, 0, ratio, 5 * ratio);
      i = Math.max(i + 1, lowerBound(event.starts, event.starts[i] + pixel));
    }
  }

  grab(event) {
    const { state, root } = this;
    if (event.button !== 0 || !state.entries.length) return;
    const [low, high] = widest(state);
    const perPixel = (high - low) / this.width;
    const span = state.t1 - state.t0;
    const at = low + (event.clientX - root.getBoundingClientRect().left - layout.gutter) * perPixel;
    if (at < state.t0 || at > state.t1) setView(state, at - span / 2, at + span / 2);
    const grabbed = { x: event.clientX, t0: state.t0 };
    root.setPointerCapture(event.pointerId);
    const move = (next) => {
      const t0 = grabbed.t0 + (next.clientX - grabbed.x) * perPixel;
      setView(state, t0, t0 + span);
    };
    const stop = () => {
      root.removeEventListener('pointermove', move);
      root.removeEventListener('pointerup', stop);
      root.removeEventListener('pointercancel', stop);
    };
    root.addEventListener('pointermove', move);
    root.addEventListener('pointerup', stop);
    root.addEventListener('pointercancel', stop);
  }
}
