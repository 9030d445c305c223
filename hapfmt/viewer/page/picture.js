// What is in sight as one picture: names, charts with their axes, flags, cursors, the axis of time.
import { layout } from './chart.js';
import { factsOf } from './head.js';
import { theme } from './theme.js';

const EDGE = 12; // px
const LINE = 18;
const FONT = '12px system-ui, sans-serif';

// -> a canvas, or null where no chart is in sight.
export function pictureOf(app) {
  const { state, panels, axis, cursors } = app;
  const open = [...panels.open.values()];
  if (!open.length) return null;
  const { ground, ink, muted, grid } = theme.colors;
  const heads = state.entries.map((entry) => [entry.name, factsOf(entry).join(' · ')]);
  const area = panels.root.getBoundingClientRect();
  const flags = [...document.querySelectorAll('#flags .flag')];
  const top = EDGE + heads.length * LINE + 8 + (flags.length ? LINE : 0);
  const timesHeight = axis.plot.height;
  const width = panels.width + 2 * EDGE;
  const height = top + area.height + timesHeight + EDGE;
  const canvas = document.createElement('canvas');
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  const context = canvas.getContext('2d');
  context.scale(devicePixelRatio, devicePixelRatio);
  context.fillStyle = ground;
  context.fillRect(0, 0, width, height);
  const write = (text, x, y, color = ink, font = FONT) => {
    Object.assign(context, { fillStyle: color, font, textBaseline: 'top', textAlign: 'left' });
    context.fillText(text, x, y);
    return context.measureText(text).width;
  };
  heads.forEach(([name, facts], i) => {
    const wide = write(name, EDGE, EDGE + i * LINE, ink, `600 ${FONT}`);
    write(facts, EDGE + wide + 12, EDGE + i * LINE, muted);
  });
  const put = (source, x, y) => context.drawImage(source, x, y, source.width / devicePixelRatio, source.height / devicePixelRatio);
  context.save();
  context.beginPath();
  context.rect(EDGE, top, panels.width, area.height);
  context.clip();
  for (const { element, title, chart } of open) {
    const y = top + element.getBoundingClientRect().top - area.top;
    context.fillStyle = grid;
    context.fillRect(EDGE, y, panels.width, 1);
    for (const name of title.querySelectorAll('.name')) {
      const box = name.getBoundingClientRect();
      const x = EDGE + box.left - area.left;
      const swatch = name.querySelector('.swatch');
      if (swatch) {
        context.fillStyle = getComputedStyle(swatch).backgroundColor;
        context.fillRect(x, y + 8, 12, 3);
      }
      write(name.querySelector('bdi').textContent, x + (swatch ? 17 : 0), y + 3);
    }
    const { canvas: drawn } = chart.plot.ctx;
    const place = drawn.getBoundingClientRect();
    put(drawn, EDGE + place.left - area.left, top + place.top - area.top);
  }
  for (const line of cursors.root.children) if (!line.hidden) drawLine(context, line, area, top, write);
  context.restore();
  for (const flag of flags) {
    const x = EDGE + flag.getBoundingClientRect().left - area.left;
    context.fillStyle = getComputedStyle(flag).borderLeftColor;
    context.fillRect(x, top - LINE, 2, 15);
    write(flag.textContent, x + 5, top - LINE + 1, getComputedStyle(flag).color, '11px system-ui, sans-serif');
  }
  put(axis.plot.ctx.canvas, EDGE, top + area.height);
  axis.unit.textContent.split('\n').forEach((text, i) => write(text, EDGE + 8, top + area.height + 7 + i * 15, muted, '11px system-ui, sans-serif'));
  context.fillStyle = grid;
  context.fillRect(EDGE + layout.gutter, top + area.height, panels.plotWidth, 1);
  return canvas;
}

// A cursor with its time, or the shade of the selection.
function drawLine(context, line, area, top, write) {
  const box = line.getBoundingClientRect();
  const x = EDGE + box.left - area.left;
  if (line.classList.contains('shade')) {
    context.fillStyle = theme.colors.select;
    context.fillRect(x, top, box.width, area.height);
    return;
  }
  context.fillStyle = line.classList.contains('hover') ? theme.colors.muted : theme.colors.ink;
  context.fillRect(x, top, 1, area.height);
  const tag = line.querySelector('.tag').getBoundingClientRect();
  write(line.textContent, EDGE + tag.left - area.left + 4, top + tag.top - area.top, theme.colors.ink, '11px system-ui, sans-serif');
}
