// The error bound of a channel, in the words of `hapfmt info` (hapfmt/cli/info.py and encode.py).

const JOINED = '\u00a0'; // a space at which no line ends

// Gives a unit for people: nothing for the unit 1, and raw for {raw}, as `unit_text` in hapfmt/units.py.
export function unitText(unit) {
  if (!unit || unit === '1') return '';
  if (unit === '{count}') return 'counts';
  return /^\{[^{}]+\}$/.test(unit) ? unit.slice(1, -1) : unit;
}

// Python's .3g, which rounds halves to the even digit.
function threeDigits(value) {
  let [digits, exponent] = value.toExponential(60).split('e');
  digits = /^\d\.\d[02468]50*$/.test(digits) ? digits.slice(0, 4) : value.toExponential(2).split('e')[0];
  exponent = Number(value.toExponential(2).split('e')[1]);
  if (exponent >= -4 && exponent < 3) return String(Number(`${digits}e${exponent}`));
  return `${Number(digits)}e${exponent < 0 ? '-' : '+'}${String(Math.abs(exponent)).padStart(2, '0')}`;
}

const amount = (value, unit) => [threeDigits(value), unitText(unit)].filter(Boolean).join(JOINED);

function boundOf(contract, track, component) {
  const unit = track.units[component];
  const moved = track.deviations[component].largest;
  if (!contract) return moved ? `within ${amount(moved, unit)}` : 'lossless';
  const { A, D } = track.calibrations[component];
  const { kn, kd, vector, guaranteed, floors } = contract;
  const least = amount(floors[Math.min(component, floors.length - 1)] * Math.abs(A / D) + moved, unit);
  const [aim, of] = [guaranteed ? '' : ', an aim', vector ? ' of the vector' : ''];
  return kn ? `deadband ${threeDigits((100 * kn) / kd)}${JOINED}%${of}, at least ${least}${aim}` : `within ${least}${of}${aim}`;
}

// A texture from a model has no bound, its slow part may.
function partText({ base, hf, component }) {
  if (![base, hf].some((track) => track?.codec === 'NOIS')) return boundOf((hf ?? base).contract, base, component);
  return base.contract ? `slow part ${boundOf(base.contract, base, component)}, synthetic texture` : 'synthetic texture';
}

export function boundText({ parts }) {
  return parts.map(partText).filter((text, i, texts) => text !== texts[i - 1]).join(', then ');
}
