// The files' facts and the buttons at the top.
import { element, setText } from './dom.js';
import { formatBytes, formatDuration, formatRate, plural } from './format.js';
import { BANDS, describeTheme } from './theme.js';
import { canAlignByEpoch } from './recordings.js';

const PRESET = /: *(lossless|near-lossless|perceptual|paper)\b/;

// Facts of a file in a few words: [{ text, title }].
export function factsOf({ recording, lanes }) {
  const rates = [...new Set(lanes.map(({ rate }) => rate))].sort((a, b) => a - b);
  const shown = rates.length > 3 ? `${formatRate(rates[0])} to ${formatRate(rates[rates.length - 1])}` : rates.map(formatRate).join(', ');
  const preset = PRESET.exec(String(recording.metadata?.encoder ?? ''))?.[1];
  const bounds = [...new Set(lanes.map(({ channel }) => channel.bound))];
  const lossless = lanes.filter(({ channel }) => channel.bound === 'lossless').length;
  return [
    formatDuration(recording.stop - recording.start),
    plural(lanes.length, 'channel'),
    shown,
    formatBytes(recording.size),
    preset === bounds[0] ? null : preset,
    bounds.length < 2 ? bounds[0] : lossless ? `${lossless} of ${plural(lanes.length, 'channel')} lossless` : null,
  ].filter(Boolean);
}

const MOST = { narrow: 3, wide: 6 }; // files with a line of their own

const narrow = matchMedia('(max-width: 900px)');

const verdictOf = ({ checked, recording }) => checked ?? recording.verdict;

const isBad = (entry) => !/^(intact|checking|not checked)/.test(verdictOf(entry)) || entry.damage.length > 0;

export class Head {
  constructor(app, facts, tools) {
    const { state } = app;
    Object.assign(this, { app, state, facts });
    const button = (text, title, run) => element('button', { type: 'button', title, onclick: run }, text);
    const toggle = (text, title, run) => element('button', { type: 'button', title, 'aria-pressed': 'false', onclick: run }, text);
    const group = (label, ...buttons) => element('span', { class: 'group', role: 'group', 'aria-label': label }, ...buttons);
    this.buttons = {
      side: toggle('Channels', 'List of channels (c)', () => this.app.toggle('side')),
      stacked: toggle('Stacked', 'One chart for each channel (m)', () => state.set({ mode: 'stacked' })),
      overlaid: toggle('Overlaid', 'One chart for each unit (m)', () => state.set({ mode: 'overlaid' })),
      map: toggle('Map', 'The channels of a unit in colours (m)', () => state.set({ mode: 'map' })),
      pairs: toggle('Compare', 'Channels with the same name in several files share a chart, and their difference has one (v)', () => this.app.toggle('pairs')),
      ...Object.fromEntries(Object.entries(BANDS).map(([band, text], i) => [band, toggle(text, `${text} (${i + 1})`, () => this.app.toggleBand(band))])),
      deadband: toggle('Error bound', 'How far the source may be from the line (d)', () => this.app.toggle('deadband')),
      knots: toggle('Knots', 'Support points of the slow part (k)', () => this.app.toggle('knots')),
      fit: toggle('Fit values', 'The scale of values fits what is in sight, not the whole recording (y)', () => this.app.toggleFit()),
      select: toggle('Select time', 'A drag on the charts selects a span of time and does not move them. Shift does the same', () => this.app.toggle('selecting')),
      align: toggle('By epoch', 'Align the files by their epochs, or by their starts (e)', () => this.app.toggleAlign()),
      theme: button('Dark', 'Light or dark (t)', () => this.app.toggleTheme()),
    };
    narrow.addEventListener('change', () => this.update());
    const b = this.buttons;
    this.bands = group('Bands', b.sum, b.lf, b.hf);
    this.bounds = group('Error bound', b.deadband, b.knots);
    for (const band of Object.keys(BANDS)) b[band].prepend(element('span', { class: `dot ${band}`, 'aria-hidden': 'true' }));
    tools.append(b.side, group('Charts', b.stacked, b.overlaid, b.map), b.pairs, this.bands, this.bounds, group('Scale', b.fit), group('Selection', b.select), b.align,
      element('span', { class: 'space' }),
      group('Zoom', button('−', 'Zoom out (−)', () => this.app.zoomBy(1.6)), button('All', 'Show all (0)', () => this.app.showAll()), button('+', 'Zoom in (+)', () => this.app.zoomBy(1 / 1.6))),
      button('Open', 'Open more files (o)', () => this.app.chooseFiles()), b.theme,
      button('?', 'Keys and help (?)', () => this.app.help.open()));
  }

  update() {
    const { state, buttons } = this;
    const pressed = {
      side: state.side, stacked: state.mode === 'stacked', overlaid: state.mode === 'overlaid', map: state.mode === 'map', pairs: state.pairs, deadband: state.deadband, knots: state.knots,
      fit: state.fit === 'view', select: state.selecting, align: state.align === 'epoch',
      ...Object.fromEntries(Object.keys(BANDS).map((band) => [band, state.bands.includes(band)])),
    };
    for (const [name, on] of Object.entries(pressed)) buttons[name].setAttribute('aria-pressed', String(on));
    const lanes = state.entries.flatMap((entry) => entry.lanes);
    this.bands.hidden = !lanes.some(({ channel }) => channel.bands.length > 1);
    buttons.deadband.hidden = !lanes.some(({ channel }) => channel.deadband);
    buttons.knots.hidden = !lanes.some(({ channel }) => channel.hasKnots);
    // The bound on the length of a vector is none on each of its channels.
    buttons.deadband.disabled = !lanes.some(({ channel }) => channel.deadband && !channel.deadband.vector);
    buttons.deadband.title = buttons.deadband.disabled ? 'The bound is on vectors of channels: no single channel has edges to draw' : 'How far the source may be from the line (d)';
    this.bounds.hidden = buttons.deadband.hidden && buttons.knots.hidden;
    buttons.pairs.hidden = state.mode !== 'stacked' || !lanes.some(({ twin }) => twin);
    buttons.align.hidden = !canAlignByEpoch(state.entries);
    describeTheme(buttons.theme);
    this.facts.replaceChildren(...this.files());
    const names = state.entries.map(({ name }) => name).join(', ');
    setText(document.querySelector('title'), names ? `${names} · hapfmt view` : 'hapfmt view');
  }

  // At most MOST files, damaged ones first where there are more, and how many others there are.
  files() {
    const { entries } = this.state;
    if (!entries.length) return [element('h1', {}, 'hapfmt view')];
    const most = MOST[narrow.matches ? 'narrow' : 'wide'];
    if (entries.length <= most) return entries.map((entry) => this.file(entry));
    const bad = entries.filter(isBad);
    const shown = [...bad, ...entries.filter((entry) => !isBad(entry))].slice(0, most - 1);
    const damaged = bad.length > shown.length ? `, ${bad.length - shown.length} damaged` : '';
    const more = element('button', {
      type: 'button', class: damaged ? 'badge bad' : 'badge', title: 'Show all files', onclick: () => this.state.set({ tab: 'files', dock: true }),
    }, `+ ${plural(entries.length - shown.length, 'file')}${damaged}`);
    return [...entries.filter((entry) => shown.includes(entry)).map((entry) => this.file(entry)), more];
  }

  file(entry) {
    const verdict = verdictOf(entry);
    const bad = isBad(entry);
    const open = entry.checked === undefined && !bad;
    const badge = element('button', {
      type: 'button', class: bad ? 'badge bad' : 'badge', title: open ? `${verdict}. Check the whole file` : 'Show the damage',
      onclick: () => {
        this.state.set({ tab: 'damage', dock: true });
        if (open) this.app.verify([entry]);
      },
    }, open ? 'not checked yet: check' : verdict);
    return element('div', { class: 'file-facts' }, element('h1', {}, element('bdi', {}, entry.name)), element('span', { class: 'facts' }, factsOf(entry).join(' · ')), badge);
  }
}
