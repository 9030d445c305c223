// Statistics of each shown channel, of the selection. They grow as the samples come.
import { eachPart, namedLane, spanFor, spanText } from './chosen.js';
import { element, setText } from './dom.js';
import { formatStepped } from './format.js';
import { Rows } from './rows.js';
import { Summary } from './summary.js';
import { Work } from './work.js';

const COLUMNS = ['Channel', 'Unit', 'Count', 'Missing', 'Lowest', 'Highest', 'Mean', 'SD', 'RMS', 'Peak to peak'];
const FACTS = ['count', 'missing', 'min', 'max', 'mean', 'sd', 'rms', 'peakToPeak'];

export const statisticsTab = { id: 'statistics', title: 'Statistics', create: (app) => new Statistics(app) };

class Statistics {
  constructor(app) {
    const { state, readings } = app;
    Object.assign(this, { app, state, readings });
    this.found = new Map(); // lane key -> { result, share } or { message }
    this.said = element('span', { class: 'said', role: 'status' });
    this.cancel = element('button', { type: 'button', onclick: () => this.stop() }, 'Stop');
    this.rows = new Rows({
      label: 'Statistics', role: 'table', rowHeight: 22, empty: 'No channel is shown.',
      render: (i, row) => this.render(this.state.lanes[i], row),
      act: (i) => this.app.focusLane(this.state.lanes[i]),
    });
    const heads = COLUMNS.map((text) => element('span', { role: 'columnheader', title: text === 'SD' ? 'Standard deviation: divided by the count' : null }, text));
    this.element = element('div', { class: 'statistics table' },
      element('div', { class: 'bar' }, this.said, this.cancel),
      element('div', { class: 'row head', role: 'row' }, ...heads), this.rows.element);
    this.work = new Work((signal, lanes) => this.compute(signal, lanes), (error) => {
      if (error) this.explain(error.message);
      this.show();
    });
  }

  update() {
    const { state, app } = this;
    const parts = state.lanes.map((lane) => `${lane.key} ${this.readings.bandOf(lane)} ${spanFor(app, lane.entry)}`);
    this.work.ask(parts.join(';'), state.lanes);
    this.show();
  }

  show() {
    this.rows.setCount(this.state.lanes.length);
    this.cancel.hidden = !this.work.busy;
  }

  explain(text) {
    setText(this.said, `${spanText(this.app)}. ${text}`);
  }

  stop() {
    this.work.stop();
    this.explain('Stopped: the last values are of a part.');
    this.show();
  }

  async compute(signal, lanes) {
    this.found = new Map();
    for (const [i, lane] of lanes.entries()) {
      const span = spanFor(this.app, lane.entry);
      const summary = new Summary();
      try {
        if (span) {
          await eachPart(lane, span, this.readings.bandOf(lane), signal, ({ value }, share) => {
            summary.push(value);
            this.found.set(lane.key, { result: summary.result(), share });
            this.explain(`Computing, ${Math.floor((100 * (i + share)) / lanes.length)} %.`);
            this.show();
          });
        }
        this.found.set(lane.key, { result: summary.result(), share: 1 });
      } catch (error) {
        if (signal.aborted) throw error;
        this.found.set(lane.key, { message: error.message });
      }
    }
    this.explain('Missing samples are not counted in the other columns.');
  }

  render(lane, row) {
    if (!lane) return; // the list is shorter since the last update
    const { result, share, message } = this.found.get(lane.key) ?? {};
    row.classList.toggle('focus', lane.key === this.state.focus);
    row.dataset.lane = lane.key;
    row.append(element('span', { role: 'rowheader' }, element('bdi', {}, namedLane(this.app, lane))), element('span', { role: 'cell' }, lane.unit));
    if (message) row.append(element('span', { role: 'cell' }, message));
    else {
      row.append(...FACTS.map((name) => {
        if (!result) return element('span', { role: 'cell' }, '…');
        const value = result[name];
        const text = name === 'count' || name === 'missing' ? String(value) : formatStepped(value, lane.step);
        const unit = name === 'count' || name === 'missing' ? '' : ` ${lane.unit}`;
        return element('span', { role: 'cell', dataset: { fact: name, value: String(value) }, class: share < 1 ? 'said' : null, title: `${value}${unit}` }, text);
      }));
    }
  }
}
