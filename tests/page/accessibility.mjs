// Looks for barriers on a page with axe-core (Deque): names, roles, contrast and structure.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';

const source = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');

/** Returns the serious and critical findings on a page as texts: the rule, and the first elements concerned. */
export async function barriers(page) {
  // The page's policy forbids scripts of others, but not what the browser's tools evaluate.
  await page.evaluate(source);
  const { violations } = await page.evaluate(() => window.axe.run(document));
  const serious = violations.filter(({ impact }) => impact === 'serious' || impact === 'critical');
  return serious.map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map((node) => node.target.join(' ')).join(', ')} (${nodes.length})`);
}
