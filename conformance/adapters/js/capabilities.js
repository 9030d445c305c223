// What the verb `capabilities` tells.
import { CODECS } from '../../../hapfmt/viewer/decoder/codecs.js';
import { MODES } from './encode.js';

export const capabilities = {
  name: 'hapf-js',
  version: '1.0',
  format: '1.0',
  verbs: ['decode', 'verify', 'recover', 'encode'],
  level: 2,
  codecs: CODECS,
  parts: [
    'tracks', 'channels', 'exact', 'physical', 'bands', 'layers', 'clocks', 'maps', 'metadata', 'attachments',
    'unknown', 'findings',
  ],
  presets: MODES,
};
