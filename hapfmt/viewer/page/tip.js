// One small box with the text of what is under the pointer or has the focus.
import { setText } from './dom.js';

const box = document.getElementById('tip');

export function showTip(text, x, y) {
  setText(box, text);
  box.hidden = false;
  const { offsetWidth, offsetHeight } = box;
  box.style.left = `${Math.max(4, Math.min(innerWidth - offsetWidth - 4, x + 10))}px`;
  box.style.top = `${y + 16 + offsetHeight > innerHeight ? y - offsetHeight - 8 : y + 16}px`;
}

export function hideTip() {
  box.hidden = true;
}
