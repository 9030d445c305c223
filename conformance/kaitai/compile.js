// node compile.js TARGET FOLDER: hapf.ksy as a parser in a target language (python, javascript, ...).
// Takes kaitai-struct-compiler and js-yaml, where node finds them.
"use strict";
const fs = require("fs");
const path = require("path");
const compiler = require("kaitai-struct-compiler");
const yaml = require("js-yaml");

const [target, folder] = process.argv.slice(2);
const text = fs.readFileSync(path.join(__dirname, "hapf.ksy"), "utf8");
compiler.compile(target, yaml.load(text), null, false).then(
  (files) => {
    for (const [name, source] of Object.entries(files)) {
      fs.writeFileSync(path.join(folder, name), source);
    }
  },
  (error) => {
    console.error(String(error.message || error));
    process.exit(1);
  },
);
