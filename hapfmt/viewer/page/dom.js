// Elements. Text of a file only ever becomes a text node.

// properties: attributes by name; `on…` functions are listeners; `class` and `dataset` as usual; null leaves out.
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith('on')) made.addEventListener(name.slice(2), value);
    else if (name === 'dataset') Object.assign(made.dataset, value);
    else made.setAttribute(name, value === true ? '' : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

const ruler = document.createElement('canvas').getContext('2d');

// Pixels of the widest of some texts.
export function widestOf(texts, font = '12px system-ui, sans-serif') {
  ruler.font = font;
  return texts.reduce((most, text) => Math.max(most, ruler.measureText(text).width), 0);
}

// At most one run of `action` in each frame of the screen.
export function eachFrame(action) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      action();
    });
  };
}

// At most one run of `action` in `delay` milliseconds; the last call is never lost.
export function atMostEvery(delay, action) {
  let timer = null;
  return () => {
    timer ??= setTimeout(() => {
      timer = null;
      action();
    }, delay);
  };
}
