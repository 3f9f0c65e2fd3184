// Opens pages in a headless browser and records all requests and errors.

import { existsSync } from 'node:fs';

import { chromium } from 'playwright-core';

const PROGRAMS = ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'];
const FLAGS = [
  '--no-sandbox',
  '--use-angle=swiftshader',
  '--enable-unsafe-swiftshader',
  '--ignore-gpu-blocklist',
  '--disable-background-networking',
  '--disable-component-update',
  '--disable-sync',
];

/** The browser's program, or null. */
export function program() {
  return [process.env.CHROMIUM, ...PROGRAMS].find((path) => path && existsSync(path)) ?? null;
}

/** Starts the browser; `flags` are added. */
export function launch(...flags) {
  return chromium.launch({ executablePath: program(), args: [...FLAGS, ...flags] });
}

/** Opens a file, and returns its page with `heard`: console messages, errors, and requests beside the page itself. */
export async function open(browser, file, { width = 1280, height = 900, dark = false, wait = true, scripts = true } = {}) {
  const context = await browser.newContext({
    viewport: { width, height },
    colorScheme: dark ? 'dark' : 'light',
    javaScriptEnabled: scripts,
    acceptDownloads: true,
  });
  const page = await context.newPage();
  page.setDefaultTimeout(120_000);
  const heard = [];
  page.on('console', (message) => heard.push(`console: ${message.text()}`));
  page.on('pageerror', (error) => heard.push(`error: ${error.message}`));
  const url = `file://${file}`;
  page.on('request', (request) => {
    // Data URLs, for pictures within the page, aren't requests.
    if (request.url() !== url && !request.url().startsWith('data:')) heard.push(`request: ${request.url().slice(0, 100)}`);
  });
  await page.goto(url);
  if (wait) await until(page, 'window.spharmReport?.ready');
  return { page, heard };
}

/** Waits until an expression is true in a page. (The page's own policy forbids what playwright would wait with.) */
export async function until(page, expression, seconds = 120) {
  for (const end = performance.now() + 1e3 * seconds; performance.now() < end; ) {
    if (await page.evaluate(expression)) return;
    await new Promise((resolve) => setTimeout(resolve, 25));
  }
  throw new Error(`not within ${seconds} s: ${expression}`);
}
