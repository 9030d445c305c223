// Mouse, pen and fingers on the charts.
import { pan, setView, showAll, zoom } from './view.js';
import { layout } from './chart.js';

const WHEEL = 0.0016; // zoom for a unit of the wheel
const CLICK = 4; // px that a click may move

export class Pointer {
  constructor(app, root) {
    const { state, panels, selection, cursors, onHover } = app;
    Object.assign(this, { state, panels, selection, cursors, onHover, root });
    this.down = new Map(); // pointer id -> its last place
    root.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    root.addEventListener('pointerdown', (event) => this.press(event));
    root.addEventListener('pointermove', (event) => this.move(event));
    root.addEventListener('pointerup', (event) => this.release(event));
    root.addEventListener('pointercancel', (event) => this.release(event));
    root.addEventListener('pointerleave', () => this.leave());
    root.addEventListener('dblclick', (event) => this.inPlot(event) && showAll(this.state));
  }

  inPlot(event) {
    const { left } = this.root.getBoundingClientRect();
    return event.clientX - left >= layout.gutter && event.clientX - left <= layout.gutter + this.panels.plotWidth;
  }

  // Over the charts it zooms; over their values, left, it scrolls.
  wheel(event) {
    const { state, panels } = this;
    if (!state.entries.length || !this.inPlot(event)) return;
    event.preventDefault();
    const scale = [1, 16, 400][event.deltaMode] ?? 1;
    const [dx, dy] = event.shiftKey ? [event.deltaX || event.deltaY, 0] : [event.deltaX, event.deltaY];
    if (Math.abs(dx) > Math.abs(dy)) {
      pan(state, (dx * scale * (state.t1 - state.t0)) / panels.plotWidth);
      return;
    }
    const strength = event.ctrlKey ? WHEEL * 5 : WHEEL;
    zoom(state, Math.exp(Math.max(-1, Math.min(1, dy * scale * strength))), panels.timeAt(event.clientX));
  }

  press(event) {
    if (event.button !== 0 || !this.inPlot(event)) return;
    this.root.setPointerCapture(event.pointerId);
    this.down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const time = this.panels.timeAt(event.clientX);
    this.moved = false;
    this.selecting = (event.shiftKey || this.state.selecting) && this.down.size === 1 ? time : null;
    this.start = { x: event.clientX, y: event.clientY };
  }

  move(event) {
    const { state, panels, selection } = this;
    if (!this.down.has(event.pointerId)) {
      state.set({ hover: this.inPlot(event) ? panels.timeAt(event.clientX) : null });
      this.onHover(event);
      return;
    }
    const before = [...this.down.values()].map(({ x }) => x);
    const last = this.down.get(event.pointerId);
    this.down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.moved ||= Math.hypot(event.clientX - this.start.x, event.clientY - this.start.y) > CLICK;
    if (!this.moved) return;
    if (this.down.size > 1) this.pinch(before, [...this.down.values()].map(({ x }) => x));
    else if (this.selecting !== null) selection.set(this.selecting, Math.max(state.start, Math.min(state.stop, panels.timeAt(event.clientX))));
    else {
      pan(state, ((last.x - event.clientX) * (state.t1 - state.t0)) / panels.plotWidth);
      this.root.scrollTop += last.y - event.clientY;
    }
    state.set({ hover: panels.timeAt(event.clientX) });
  }

  // The two times under the fingers stay under them.
  pinch([a0, b0], [a1, b1]) {
    const { state, panels } = this;
    if (Math.abs(b1 - a1) < 8) return;
    const [left, right] = [panels.timeAt(a0), panels.timeAt(b0)];
    const perPixel = (right - left) / (b1 - a1);
    const origin = panels.timeAt(0);
    const zero = (origin - state.t0) / (state.t1 - state.t0) * panels.plotWidth; // px of clientX 0
    const t0 = left - (a1 + zero) * perPixel;
    setView(state, t0, t0 + perPixel * panels.plotWidth);
  }

  release(event) {
    if (!this.down.delete(event.pointerId)) return;
    if (this.moved || event.type === 'pointercancel') return;
    if (this.selecting !== null) this.selection.clear();
    else if (event.detail < 2) this.cursors.place(this.panels.timeAt(event.clientX));
  }

  leave() {
    this.state.set({ hover: null });
    this.onHover(null);
  }
}
