// Light or dark, and the colours. One colour has one meaning, and colour-blind people can distinguish all of them.
import { setText } from './dom.js';

export const BANDS = { sum: 'Signal', lf: 'LF', hf: 'HF' };

// Overlaid channels, at least 3:1 against the ground. After Okabe and Ito (2008), without vermilion, which means damage.
const CHANNELS = {
  light: ['#0072b2', '#b36b00', '#00805c', '#a8518a', '#3a8fc4', '#6b6b6b', '#7a5c00', '#5a4fbf'],
  dark: ['#4aa8e0', '#e69f00', '#2fbf93', '#dd8fbd', '#8fd0f5', '#b5b5b5', '#d8c84a', '#a79cf5'],
};

// Where colours come again, dashes tell the channels apart.
const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3]];

// How many channels colours and dashes tell apart.
export const DISTINCT = CHANNELS.light.length * DASHES.length;

export const theme = { name: 'light', colors: {} };

// wanted: 'light', 'dark' or 'auto', as the system says.
export function applyTheme(wanted) {
  const dark = wanted === 'dark' || (wanted === 'auto' && matchMedia('(prefers-color-scheme: dark)').matches);
  theme.name = dark ? 'dark' : 'light';
  document.documentElement.dataset.theme = theme.name;
  const style = getComputedStyle(document.documentElement);
  const names = ['ground', 'ink', 'muted', 'grid', 'sum', 'lf', 'hf', 'damage', 'event', 'gap', 'deadband', 'select'];
  theme.colors = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  patterns.clear();
}

export function colorOfChannel(number) {
  const list = CHANNELS[theme.name];
  return list[number % list.length];
}

// Mixes a colour with the ink, for another version of the same channel.
export function versionColor(color) {
  const parts = (text) => [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16));
  const ink = parts(theme.colors.ink);
  return `#${parts(color).map((part, i) => Math.round((part + ink[i]) / 2).toString(16).padStart(2, '0')).join('')}`;
}

export function dashOfChannel(number) {
  return DASHES[Math.floor(number / CHANNELS.light.length) % DASHES.length];
}

const patterns = new Map();

// Hatching in a colour; `rising` tells damage from gaps without colour.
export function hatch(context, color, rising) {
  const key = `${color} ${rising} ${devicePixelRatio}`;
  if (!patterns.has(key)) {
    const size = Math.round(8 * devicePixelRatio);
    const tile = document.createElement('canvas');
    tile.width = tile.height = size;
    const draw = tile.getContext('2d');
    draw.strokeStyle = color;
    draw.lineWidth = devicePixelRatio;
    for (const shift of [-size, 0, size]) {
      draw.moveTo(shift, rising ? size : 0);
      draw.lineTo(shift + size, rising ? 0 : size);
    }
    draw.stroke();
    patterns.set(key, context.createPattern(tile, 'repeat'));
  }
  return patterns.get(key);
}

export function nextTheme(wanted) {
  return { auto: theme.name === 'dark' ? 'light' : 'dark', light: 'dark', dark: 'light' }[wanted];
}

export function describeTheme(button) {
  setText(button, theme.name === 'dark' ? 'Light' : 'Dark');
}
