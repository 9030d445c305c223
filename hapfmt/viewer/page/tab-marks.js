// Lists of events and of damage; a click goes there.
import { element } from './dom.js';
import { formatDuration, formatTime, plural, quoted } from './format.js';
import { goToMark, spanOf } from './marks.js';
import { markText } from './flags.js';
import { Rows } from './rows.js';

const NAMED = 6; // channels that a line names

export const eventsTab = {
  id: 'events', title: 'Events', create: (app) => new Marks(app, { kind: 'event', title: 'Events', none: 'No file has events.' }),
};

export const damageTab = { id: 'damage', title: 'Damage', create: (app) => new Damage(app) };

class Marks {
  constructor(app, { kind, title, none }) {
    const { state } = app;
    Object.assign(this, { app, state, kind, name: title });
    this.list = [];
    this.rows = new Rows({
      label: title, rowHeight: 22, empty: none,
      render: (i, row) => this.render(this.list[i], row),
      act: (i) => this.go(this.list[i]),
    });
    this.element = element('div', { class: `marks ${kind}` }, this.rows.element);
  }

  marks() {
    const { list } = this.state.marks[this.kind];
    return this.kind === 'damage' ? [...this.state.wholeDamage, ...list] : list;
  }

  title() {
    const { length } = this.marks();
    return length ? `${this.name} ${length}` : this.name;
  }

  update() {
    this.list = this.marks();
    this.rows.setCount(this.list.length);
  }

  render(mark, row) {
    const [start, stop] = spanOf(mark);
    const time = mark.whole ? 'whole file' : `${formatTime(start, 3)}${stop > start ? ` to ${formatTime(stop, 3)}` : ''} s`;
    const file = this.state.entries.length > 1 ? `${mark.entry.name}: ` : '';
    row.title = markText(mark);
    row.append(element('span', { class: 'when' }, time), element('bdi', {}, file + markText(mark)));
  }

  go(mark) {
    goToMark(this.app, mark);
  }
}

class Damage extends Marks {
  constructor(app) {
    super(app, { kind: 'damage', title: 'Damage', none: 'No damage was found in what was read so far.' });
    this.said = element('span', { class: 'said' });
    this.check = element('button', { type: 'button', onclick: () => this.app.verify() }, 'Check whole files');
    this.losses = element('div', { class: 'losses' });
    this.element.prepend(element('div', { class: 'bar' }, this.check, this.said), this.losses);
  }

  update() {
    super.update();
    const parts = this.state.entries.filter(({ checked }) => checked !== undefined).map(({ name, checked }) => `${name}: ${checked}`);
    this.said.textContent = parts.join(' · ');
    const damaged = this.state.entries.filter(({ findings }) => findings?.verdict === 'damaged');
    const texts = damaged.map((entry) => lossText(entry));
    if (texts.join() !== this.told) {
      this.told = texts.join();
      this.losses.replaceChildren(...damaged.map((entry, i) => element('p', {}, texts[i], ' To keep what is intact, run: ', element('code', {}, recoverCommand(entry)))));
    }
    this.rows.empty = this.state.entries.some(({ findings }) => findings) ? 'No damage.' : 'No damage was found in what was read so far.';
  }
}

// What `hapfmt verify` tells of each channel.
function lossText({ name, findings: { channels } }) {
  const lost = channels.filter(({ lost_ticks: ticks }) => ticks !== 0);
  const texts = lost.slice(0, NAMED).map(({ channel, label, lost_ticks: ticks, lost_s: seconds }) => `${label || `channel ${channel}`} ${
    ticks === null ? 'an unknown number' : `${plural(ticks, 'sample')} (${formatDuration(seconds)})`}`);
  if (lost.length > NAMED) texts.push(`and ${plural(lost.length - NAMED, 'more channel')}`);
  return `${name}: ${lost.length ? `${lost.length} of ${plural(channels.length, 'channel')} lost samples to damage, at most ${texts.join(', ')}.` : 'damaged, no sample is known to be lost.'}`;
}

const recoverCommand = ({ name }) => `hapfmt recover ${quoted(name)} ${quoted(`${name.replace(/\.hapf$/i, '')}-recovered.hapf`)}`;

export function checkedText({ verdict, findings }) {
  return findings.length ? `${verdict}, ${plural(findings.length, 'finding')}` : verdict;
}
