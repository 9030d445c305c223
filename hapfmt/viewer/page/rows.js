// A long list of which only the rows in sight are elements. One tab stop; the arrow keys move the active row.
import { element } from './dom.js';

let lists = 0;

// render(i, row): fills an empty div; act(i, event): Enter or click; toggle(i): Space.
export class Rows {
  constructor({ label, role = 'listbox', rowHeight = 24, render, act = () => {}, toggle = act, empty = '' }) {
    Object.assign(this, { rowHeight, render, act, toggle, empty });
    this.count = 0;
    this.active = 0;
    this.rowRole = role === 'listbox' ? 'option' : 'row';
    this.prefix = `rows-${lists++}`;
    this.inner = element('div', { class: 'rows-inner', role: 'presentation', onclick: (event) => this.click(event) });
    this.element = element('div', {
      class: 'rows', role, tabindex: '0', 'aria-label': label,
      onscroll: () => this.draw(),
      onkeydown: (event) => this.keydown(event),
    }, this.inner);
    new ResizeObserver(() => this.draw()).observe(this.element);
  }

  setCount(count) {
    this.count = count;
    this.active = Math.min(this.active, Math.max(0, count - 1));
    this.draw();
  }

  // Makes all rows in sight again.
  draw() {
    const { count, rowHeight, inner } = this;
    inner.style.height = `${Math.min(count * rowHeight, 1e7)}px`;
    const first = Math.max(0, Math.floor(this.element.scrollTop / rowHeight) - 2);
    const last = Math.min(count, first + Math.ceil(this.element.clientHeight / rowHeight) + 4);
    this.range = [first, last];
    inner.replaceChildren();
    if (!count && this.empty) inner.append(element('p', { class: 'empty' }, this.empty));
    for (let i = first; i < last; i++) inner.append(this.row(i));
    this.markActive();
  }

  row(i) {
    const row = element('div', {
      class: 'row', role: this.rowRole, id: `${this.prefix}-${i}`, 'aria-posinset': i + 1, 'aria-setsize': this.count,
    });
    row.style.top = `${i * this.rowHeight}px`;
    row.style.height = `${this.rowHeight}px`;
    this.render(i, row);
    return row;
  }

  // By its place: rows may be made again between the press and the release of a button.
  click(event) {
    const i = Math.floor((event.clientY - this.inner.getBoundingClientRect().top) / this.rowHeight);
    if (i < 0 || i >= this.count) return;
    this.active = i;
    this.markActive();
    this.act(i, event);
  }

  markActive() {
    for (const row of this.inner.children) row.classList.toggle('active', row.id === `${this.prefix}-${this.active}`);
    if (this.count) this.element.setAttribute('aria-activedescendant', `${this.prefix}-${this.active}`);
    else this.element.removeAttribute('aria-activedescendant');
  }

  moveTo(i) {
    this.active = Math.max(0, Math.min(this.count - 1, i));
    const top = this.active * this.rowHeight;
    const { scrollTop, clientHeight } = this.element;
    if (top < scrollTop) this.element.scrollTop = top;
    else if (top + this.rowHeight > scrollTop + clientHeight) this.element.scrollTop = top + this.rowHeight - clientHeight;
    this.draw();
  }

  keydown(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const page = Math.max(1, Math.floor(this.element.clientHeight / this.rowHeight) - 1);
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -this.count, End: this.count };
    if (event.key in steps) this.moveTo(this.active + steps[event.key]);
    else if (event.key === 'Enter' && this.count) this.act(this.active, event);
    else if (event.key === ' ' && this.count) this.toggle(this.active, event);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
