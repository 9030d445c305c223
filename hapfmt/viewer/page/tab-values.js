// The values at the cursors, of every shown channel.
import { element, setText } from './dom.js';
import { formatStepped } from './format.js';
import { Rows } from './rows.js';

const COLUMNS = ['Channel', 'Unit', 'Pointer', 'A', 'B', 'B − A'];

export const valuesTab = { id: 'values', title: 'Values', create: (app) => new Values(app) };

class Values {
  constructor(app) {
    const { state, cursors, readings } = app;
    Object.assign(this, { app, state, cursors, readings });
    this.heads = COLUMNS.map((text) => element('span', { role: 'columnheader' }, text));
    this.rows = new Rows({
      label: 'Values at the cursors', role: 'table', rowHeight: innerWidth > 600 ? 22 : 40, empty: 'No channel is shown.',
      render: (i, row) => this.render(this.state.lanes[i], row),
      act: (i) => this.app.focusLane(this.state.lanes[i]),
    });
    this.element = element('div', { class: 'values table' }, element('div', { class: 'row head', role: 'row' }, ...this.heads), this.rows.element);
  }

  update() {
    const { state, cursors } = this;
    const times = [state.hover, state.a, state.b].map((time) => (time === null ? '' : ` ${cursors.text(time)} s`));
    const gap = state.a !== null && state.b !== null ? ` ${cursors.text(state.b - state.a)} s` : '';
    [...times, gap].forEach((text, i) => setText(this.heads[i + 2], COLUMNS[i + 2] + text));
    this.rows.setCount(state.lanes.length);
  }

  render(lane, row) {
    if (!lane) return; // the list is shorter since the last update
    const { state, readings } = this;
    const found = [state.hover, state.a, state.b].map((time) => (time === null ? null : readings.at(lane, time)));
    const cell = (reading) => {
      if (reading === null) return element('span', { role: 'cell' });
      if (!reading) return element('span', { role: 'cell' }, '…');
      return element('span', {
        role: 'cell', dataset: { value: String(reading.value), sample: reading.number }, title: reading.message ?? `sample ${reading.number}: ${reading.value}`,
      }, formatStepped(reading.value, lane.step));
    };
    const [, a, b] = found;
    const difference = a && b ? b.value - a.value : null;
    row.classList.toggle('focus', lane.key === state.focus);
    row.dataset.lane = lane.key;
    row.append(
      element('span', { role: 'rowheader' }, element('bdi', {}, (state.entries.length > 1 ? `${lane.entry.name}: ` : '') + lane.name)),
      element('span', { role: 'cell' }, lane.unit),
      ...found.map(cell),
      element('span', { role: 'cell', ...(difference === null ? {} : { dataset: { value: String(difference) } }) }, difference === null ? '' : formatStepped(difference, lane.step)),
    );
  }
}
