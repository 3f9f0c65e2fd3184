// Bundles the page's script into the file named by the argument, as one classic script without imports.
import { readFileSync } from 'node:fs';

import { build } from 'esbuild';

const notice = readFileSync('node_modules/three/LICENSE', 'utf8').trim();

await build({
  entryPoints: ['src/main.js'],
  bundle: true,
  minify: true,
  format: 'iife',
  target: 'es2022',
  charset: 'ascii',
  legalComments: 'none',
  footer: { js: `/*! three.js\n${notice}\n*/` },
  outfile: process.argv[2],
  logLevel: 'warning',
});
