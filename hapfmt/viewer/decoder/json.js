// JSON as mETa needs it (MET-001, RFC 8259): strict, bounded, and no digit of a number lost.
import { decodeText } from './bytes.js';
import { HapfError, unsupported } from './error.js';

const DEPTH_BOUND = 64;
const NUMBER_BOUND = 1000;
// Three bytes can be a list (docs/spec/security.md): what this reader keeps of one text.
const VALUE_BOUND = 2 ** 21;
const NUMBER = /-?(?:0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?/y;
const SPACE = /[ \t\n\r]*/y;
const PLAIN = /[^"\\\u0000-\u001f]*/y;
const ESCAPES = { '"': '"', '\\': '\\', '/': '/', b: '\b', f: '\f', n: '\n', r: '\r', t: '\t' };

class Parser {
  constructor(text, offset) {
    this.text = text;
    this.at = 0;
    this.values = 0;
    this.offset = offset;
  }

  fail(message) {
    throw new HapfError('broken', 'MET-001', `${message}, at character ${this.at}`, this.offset);
  }

  match(expression) {
    expression.lastIndex = this.at;
    const found = expression.exec(this.text);
    if (found) this.at = expression.lastIndex;
    return found;
  }

  space() {
    this.match(SPACE);
  }

  take(character) {
    if (this.text[this.at] !== character) return false;
    this.at++;
    return true;
  }

  value(depth) {
    if (++this.values > VALUE_BOUND) unsupported('LIM-003', 'more JSON values than this reader keeps', this.offset);
    const first = this.text[this.at];
    if (first === '{') return this.object(depth + 1);
    if (first === '[') return this.array(depth + 1);
    if (first === '"') return this.string();
    for (const [word, value] of [['true', true], ['false', false], ['null', null]]) {
      if (this.text.startsWith(word, this.at)) {
        this.at += word.length;
        return value;
      }
    }
    return this.number();
  }

  object(depth) {
    if (depth > DEPTH_BOUND) this.fail('nested too deep');
    const object = Object.create(null);
    this.at++;
    this.space();
    if (this.take('}')) return object;
    for (;;) {
      if (this.text[this.at] !== '"') this.fail('no name of a member');
      const name = this.string();
      this.space();
      if (!this.take(':')) this.fail('no colon');
      this.space();
      object[name] = this.value(depth);
      this.space();
      if (this.take('}')) return object;
      if (!this.take(',')) this.fail('no comma');
      this.space();
    }
  }

  array(depth) {
    if (depth > DEPTH_BOUND) this.fail('nested too deep');
    const array = [];
    this.at++;
    this.space();
    if (this.take(']')) return array;
    for (;;) {
      array.push(this.value(depth));
      this.space();
      if (this.take(']')) return array;
      if (!this.take(',')) this.fail('no comma');
      this.space();
    }
  }

  string() {
    this.at++;
    let text = '';
    for (;;) {
      text += this.match(PLAIN)[0];
      if (this.take('"')) break;
      if (!this.take('\\')) this.fail('a text without its end, or with a control character');
      const character = this.text[this.at++];
      if (character === 'u') {
        const digits = this.text.slice(this.at, this.at + 4);
        if (!/^[0-9a-fA-F]{4}$/.test(digits)) this.fail('no four hexadecimal digits');
        text += String.fromCharCode(parseInt(digits, 16));
        this.at += 4;
      } else if (Object.hasOwn(ESCAPES, character ?? '')) {
        text += ESCAPES[character];
      } else {
        this.fail('an unknown escape');
      }
    }
    if (!text.isWellFormed()) this.fail('a text with half a surrogate pair');
    return text;
  }

  number() {
    const found = this.match(NUMBER);
    if (!found) this.fail('no value');
    const [token, fraction, exponent] = found;
    if (token.length > NUMBER_BOUND) this.fail('a number of more than 1000 characters');
    if (fraction === undefined && exponent === undefined) {
      const value = Number(token);
      return Number.isSafeInteger(value) ? value : BigInt(token);
    }
    const value = Number(token);
    if (!Number.isFinite(value)) this.fail('a number that is not finite');
    return value;
  }
}

// The object that the bytes hold. Integers of 2^53 and more are BigInts.
export function readMetadata(bytes, offset) {
  let text;
  try {
    text = decodeText(bytes, offset);
  } catch (error) {
    error.also = ['MET-001'];
    throw error;
  }
  const parser = new Parser(text, offset);
  parser.space();
  if (text[parser.at] !== '{') parser.fail('no JSON object');
  const object = parser.value(0);
  parser.space();
  if (parser.at < text.length) parser.fail('more than one value');
  return object;
}

// JSON text of values that may be BigInts.
export function writeJson(value) {
  if (typeof value === 'bigint') return String(value);
  if (Object.is(value, -0)) return '-0';
  if (Array.isArray(value)) return `[${value.map(writeJson).join(',')}]`;
  if (value && typeof value === 'object') {
    const members = Object.keys(value).filter((name) => value[name] !== undefined);
    return `{${members.map((name) => `${JSON.stringify(name)}:${writeJson(value[name])}`).join(',')}}`;
  }
  return JSON.stringify(value);
}
