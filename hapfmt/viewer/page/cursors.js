// One line at the pointer, and two that stay, A and B, over all charts; the selection behind them.
import { element, setText } from './dom.js';
import { layout } from './chart.js';
import { formatTime, decimalsOf, formatStepped, withUnit } from './format.js';

export class Cursors {
  constructor(app, root) {
    const { state, panels, selection, readings } = app;
    Object.assign(this, { state, panels, selection, readings, root });
    this.lines = Object.fromEntries(['hover', 'a', 'b'].map((name) => {
      const tag = element('span', { class: 'tag' });
      const line = element('div', { class: `line ${name}` }, tag);
      root.append(line);
      return [name, { line, tag }];
    }));
    this.shade = element('div', { class: 'shade' });
    root.append(this.shade);
  }

  // A time as the view can tell it apart.
  text(time) {
    const { state } = this;
    const span = state.t1 - state.t0;
    return formatTime(time, decimalsOf(span / 1e4), Math.max(Math.abs(state.t0), Math.abs(state.t1)));
  }

  draw() {
    const { state, panels, selection } = this;
    const right = layout.gutter + panels.plotWidth;
    for (const [name, { line, tag }] of Object.entries(this.lines)) {
      const time = state[name];
      const x = time === null ? -1 : panels.xOf(time);
      line.hidden = x < layout.gutter - 0.5 || x > right + 0.5;
      if (line.hidden) continue;
      line.style.transform = `translateX(${x}px)`;
      line.classList.toggle('flip', x > right - 110);
      setText(tag, `${name === 'hover' ? '' : `${name.toUpperCase()} `}${this.text(time)}`);
    }
    const { range } = selection;
    const from = range ? Math.max(layout.gutter, panels.xOf(range[0])) : 0;
    const to = range ? Math.min(right, panels.xOf(range[1])) : 0;
    this.shade.hidden = to <= from;
    this.shade.style.transform = `translateX(${from}px)`;
    this.shade.style.width = `${to - from}px`;
    this.showReadings();
  }

  showReadings() {
    const { state, panels, readings } = this;
    const time = state.hover ?? state.a;
    panels.showReadings((lane, difference) => {
      if (time === null) return '';
      const reading = readings.at(lane, time);
      const first = difference ? readings.at(lane.twin, time) : { value: 0 };
      return reading && first && withUnit(formatStepped(reading.value - first.value, lane.step), lane.unit);
    });
  }

  // A, then B, then A again.
  place(time) {
    const { state } = this;
    if (state.a === null || state.b !== null) state.set({ a: time, b: null });
    else state.set({ b: time });
  }
}
