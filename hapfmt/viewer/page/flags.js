// Flags of events and damage above the charts. Those too close to one another share a flag.
import { element } from './dom.js';
import { plural } from './format.js';
import { layout } from './chart.js';
import { goToMark, spanOf } from './marks.js';
import { lowerBound } from './signals.js';
import { hideTip, showTip } from './tip.js';
import { setView } from './view.js';

const SPACE = 16; // px of a flag
const LONGEST = 190; // px of a flag's text
const LISTED = 6; // marks that one text tells

export class Flags {
  constructor(app, root) {
    const { state, panels } = app;
    Object.assign(this, { app, state, panels, root });
    root.setAttribute('role', 'toolbar');
    root.setAttribute('aria-label', 'Events and damage in sight');
    root.addEventListener('keydown', (event) => this.keydown(event));
    this.shown = '';
  }

  draw() {
    const { state, panels, root } = this;
    const { t0, t1 } = state;
    const flags = [];
    const count = Math.max(1, Math.floor(panels.plotWidth / SPACE));
    const step = (t1 - t0) / count;
    for (const kind of ['damage', 'event']) {
      const { list, starts } = state.marks[kind];
      const before = kind === 'damage' ? list.filter((mark) => spanOf(mark)[0] < t0 && spanOf(mark)[1] > t0) : [];
      if (before.length) flags.push({ kind, marks: before, count: before.length, time: t0 });
      for (let i = lowerBound(starts, t0); i < starts.length && starts[i] <= t1;) {
        const next = Math.max(i + 1, lowerBound(starts, starts[i] + step));
        flags.push({ kind, marks: list.slice(i, Math.min(next, i + LISTED)), count: next - i, time: starts[i], last: starts[next - 1] });
        i = next;
      }
    }
    flags.sort((one, other) => one.time - other.time);
    flags.forEach((flag, i) => {
      flag.room = i + 1 < flags.length ? panels.xOf(flags[i + 1].time) - panels.xOf(flag.time) : Infinity;
    });
    const key = flags.map(({ kind, count: n, time }) => `${kind} ${n} ${Math.round(panels.xOf(time))}`).join();
    if (key === this.shown) return;
    this.shown = key;
    const at = [...root.children].indexOf(document.activeElement);
    root.replaceChildren(...flags.map((flag, i) => this.flag(flag, i)));
    if (at >= 0) root.children[Math.min(at, root.children.length - 1)]?.focus();
  }

  flag({ kind, marks, count, time, last, room }, i) {
    const text = [...marks.map((mark) => markText(mark)), ...(count > marks.length ? [`and ${count - marks.length} more`] : [])].join('\n');
    const show = (event) => {
      const { left, bottom } = event.currentTarget.getBoundingClientRect();
      showTip(text, left, bottom - 12);
    };
    const first = count === 1 ? [marks[0].title, kind === 'damage' ? namesOf(marks[0]) : ''].filter(Boolean).join(' · ') : plural(count, kind === 'event' ? 'event' : 'damaged place');
    const button = element('button', {
      class: `flag ${kind}`, type: 'button', tabindex: i ? '-1' : '0', 'aria-label': text,
      onmouseenter: show, onmouseleave: hideTip, onfocus: show, onblur: hideTip,
      onclick: () => {
        if (count > 1 && last > time) setView(this.state, time - (last - time) * 0.2, last + (last - time) * 0.2);
        else goToMark(this.app, marks[0]);
      },
    }, element('span', {}, first));
    button.style.maxWidth = `${Math.max(SPACE / 2, Math.min(LONGEST, room - 1))}px`;
    button.style.left = `${this.panels.xOf(time)}px`;
    return button;
  }

  keydown(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const all = [...this.root.children];
    all[all.indexOf(document.activeElement) + step]?.focus();
    event.preventDefault();
    event.stopPropagation();
  }
}

function namesOf({ entry, channels }) {
  const names = channels?.slice(0, 4).map((index) => entry.lanes.find((lane) => lane.index === index)?.name ?? index).join(', ');
  const more = channels?.length > 4 ? ` and ${channels.length - 4} more channels` : '';
  return names ? names + more : '';
}

export function markText(mark) {
  const { kind, title, text } = mark;
  return [`${kind === 'damage' ? 'Damage: ' : ''}${title}`, text && text !== title ? text : '', namesOf(mark)].filter(Boolean).join(' · ');
}
