// The panel below, with tabs. A tab is { id, title, create(app) }; create returns { element, update(), title?() }.
// `share`: how much of the height of the page it opens with.
// update() runs while the tab is open, after each change of the page; title() may add a count.
import { eachFrame, element, setText } from './dom.js';

const LEAST = 90;
const USUAL = 190; // px

// The values are folded until there is a cursor that they are of.
export const isOpen = ({ dock, a, b }) => dock ?? (a !== null || b !== null);

export class Dock {
  constructor(app, root, tabs) {
    Object.assign(this, { state: app.state, root });
    this.bar = element('div', { role: 'tablist', 'aria-label': 'Details', onkeydown: (event) => this.keydown(event) });
    this.grip = element('div', {
      class: 'grip', role: 'separator', tabindex: '0', 'aria-orientation': 'horizontal', 'aria-label': 'Height of the details',
      onpointerdown: (event) => this.drag(event),
      onkeydown: (event) => this.resizeByKey(event),
    });
    this.body = element('div', { class: 'dock-body' });
    this.hide = element('button', { type: 'button', class: 'hide', onclick: () => this.state.set({ dock: !isOpen(this.state) }) });
    root.append(this.grip, element('div', { class: 'dock-head' }, this.bar, this.hide), this.body);
    this.tabs = tabs.map((tab) => {
      const made = tab.create(app);
      const button = element('button', {
        type: 'button', role: 'tab', id: `tab-${tab.id}`, 'aria-controls': `panel-${tab.id}`, onclick: () => this.state.set({ tab: tab.id, dock: true }),
      }, tab.title);
      const panel = element('div', { role: 'tabpanel', id: `panel-${tab.id}`, 'aria-labelledby': `tab-${tab.id}` }, made.element);
      this.bar.append(button);
      this.body.append(panel);
      return { ...tab, made, button, panel };
    });
    this.update = eachFrame(() => this.draw());
  }

  draw() {
    const { state, root } = this;
    const open = isOpen(state);
    const known = this.tabs.find(({ id }) => id === state.tab) ?? this.tabs[0];
    this.height = state.dockHeight ?? Math.max(USUAL, Math.round(innerHeight * (known.share ?? 0)));
    root.classList.toggle('closed', !open);
    root.style.setProperty('--dock', `${this.height}px`);
    setText(this.hide, open ? 'Hide' : 'Show');
    this.hide.setAttribute('aria-expanded', String(open));
    for (const { id, title, made, button, panel } of this.tabs) {
      const chosen = id === known.id;
      button.setAttribute('aria-selected', String(chosen && open));
      button.tabIndex = chosen ? 0 : -1;
      setText(button, made.title?.() ?? title);
      panel.hidden = !chosen || !open;
      if (!panel.hidden) made.update();
      if (chosen && this.chosen !== id) {
        this.chosen = id;
        button.scrollIntoView({ block: 'nearest', inline: 'center' });
      }
    }
  }

  keydown(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const now = this.tabs.findIndex(({ button }) => button === document.activeElement);
    const next = this.tabs[(now + step + this.tabs.length) % this.tabs.length];
    this.state.set({ tab: next.id, dock: true });
    next.button.focus();
    event.preventDefault();
    event.stopPropagation();
  }

  setHeight(height) {
    this.state.set({ dockHeight: Math.round(Math.max(LEAST, Math.min(innerHeight - 260, height))) });
  }

  drag(event) {
    const { grip } = this;
    grip.setPointerCapture(event.pointerId);
    const [from, height] = [event.clientY, this.root.clientHeight];
    grip.onpointermove = (move) => this.setHeight(height + from - move.clientY);
    grip.onpointerup = grip.onpointercancel = () => {
      grip.onpointermove = grip.onpointerup = grip.onpointercancel = null;
    };
  }

  resizeByKey(event) {
    const step = { ArrowUp: 24, ArrowDown: -24 }[event.key];
    if (!step) return;
    this.setHeight(this.height + step);
    event.preventDefault();
    event.stopPropagation();
  }
}
