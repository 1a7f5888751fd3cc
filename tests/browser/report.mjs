// The report of a lens in a browser: every section is there, a value under the pointer is the JSON's, sliders step, nothing is fetched from
// outside, nothing overflows on a desk or on a phone; `view` redraws a saved edit. `.ci/slow browser` runs it.
//
// node report.mjs ISOPLANAT CHROMIUM
import { execFileSync, spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createRequire } from 'node:module';

const { chromium } = createRequire(join(process.cwd(), 'package.json'))('playwright-core');
const [program, executablePath] = process.argv.slice(2);
const folder = mkdtempSync(join(tmpdir(), 'isoplanat-'));
let failures = 0;
const check = (holds, what) => {
  if (!holds) { failures += 1; console.error(`FAILED: ${what}`); }
};
// As the pages write numbers: six significant digits without needless zeros.
const shown = v => {
  if (v === 0) return '0';
  const exponent = Math.floor(Math.log10(Math.abs(v)));
  if (exponent < -4 || exponent >= 7) return null;
  const text = v.toFixed(Math.max(0, 5 - exponent));
  return text.includes('.') ? text.replace(/0+$/, '').replace(/\.$/, '') : text;
};
const SECTIONS = ['layout', 'third-order-sums', 'spots', 'ray-and-path-fans', 'wavefronts', 'over-the-field',
  'point-spread-functions', 'modulation-transfer', 'numerical-check', 'accuracy-and-time'];

const browser = await chromium.launch({
  executablePath,
  args: ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync'],
});
try {
  for (const lens of process.env.LENSES?.split(',') ?? ['cooke_triplet', 'double_gauss', 'two_element', 'phone', 'hologon']) {
    const file = join(folder, `${lens}.html`);
    const json = JSON.parse(execFileSync(program, ['report', lens, '-o', file, '--json'], { maxBuffer: 1 << 28 }));
    for (const [width, height] of [[1280, 900], [390, 844]]) {
      const page = await browser.newPage({ viewport: { width, height } });
      const asked = [];
      page.on('request', r => { if (!r.url().startsWith('file:') && !r.url().startsWith('data:')) asked.push(r.url()); });
      page.on('pageerror', e => check(false, `${lens}: script: ${e}`));
      await page.goto(`file://${file}`);
      for (const id of SECTIONS) check(await page.locator(`section#${id} > h2`).count() === 1, `${lens}: section ${id}`);
      const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      check(over <= 0, `${lens} at ${width}: ${over} pixels wider than the window`);
      check(asked.length === 0, `${lens}: fetches ${asked}`);
      if (width > 1000) {
        // Points of every named plot under the pointer.
        for (const [name, plot] of Object.entries(json.plots)) {
          const series = plot.series.find(s => s.points.length > 2);
          if (!series) continue;
          const svg = page.locator(`svg[aria-label="${plot.title.replaceAll('"', '\\"')}"]:visible`).first();
          if (await svg.count() === 0) { check(name.startsWith('mtf') , `${lens}: no plot ${plot.title}`); continue; }
          await svg.scrollIntoViewIfNeeded();
          const k = Math.floor(series.points.length / 2);
          const at = await svg.evaluate((node, [wanted, k]) => {
            const s = [...node.querySelectorAll('.s[data-v]')].find(s => s.dataset.name === wanted);
            const p = s.querySelector('polyline').points.getItem(k).matrixTransform(node.getScreenCTM());
            return [p.x, p.y];
          }, [series.name, k]);
          await page.mouse.move(at[0], at[1]);
          const text = await page.locator('#value').textContent();
          // Another series may pass through the same place: its point must be the JSON's too.
          const numbers = text.split('\n').slice(-2).map(line => line.slice(line.lastIndexOf(': ') + 2));
          const known = plot.series.some(s => s.points.some(p => {
            const [x, y] = [shown(p[0]), shown(p[1])];
            return (x === null || x === numbers[0]) && (y === null || y === numbers[1]);
          }));
          check(known, `${lens}: ${plot.title}: "${text}" is not in the JSON`);
        }
        const slider = page.locator('.steps input').first();
        await slider.fill('0');
        check((await page.locator('.steps').first().locator('figure:visible').getAttribute('data-k')) === '0', `${lens}: slider`);
        const lit = page.locator('svg .s[data-key="f0"][data-v]:visible').first();
        await lit.evaluate(node => node.ownerSVGElement.scrollIntoView({ block: 'center' }));
        const place = await lit.evaluate(node => {
          const p = node.querySelector('polyline').points.getItem(3).matrixTransform(node.ownerSVGElement.getScreenCTM());
          return [p.x, p.y];
        });
        await page.mouse.move(place[0], place[1]);
        check(await page.evaluate(() => document.body.classList.contains('lit')), `${lens}: a field stands out`);
      }
      await page.close();
    }
  }

  // The page follows the file.
  const file = join(folder, 'lens.toml');
  execFileSync(program, ['convert', 'cooke_triplet', file]);
  const text = readFileSync(file, 'utf8');
  const server = spawn(program, ['view', file]);
  const address = await new Promise(done => server.stdout.on('data', d => done(String(d).trim())));
  try {
    const page = await browser.newPage({ viewport: { width: 1280, height: 900 } });
    page.on('pageerror', e => check(false, `view: script: ${e}`));
    // Whatever the page's policy does not allow, and every request that is refused.
    page.on('console', m => { if (m.type() === 'error') check(false, `view: ${m.text()}`); });
    await page.goto(address);
    check(await page.locator('#value').count() === 1, 'the page\'s own script runs');
    const bare = await fetch(address.split('?')[0]);
    check(bare.status === 403, `without the token: ${bare.status}`);
    // A page elsewhere gets no answer it could read, and cannot frame this one.
    const other = await browser.newPage();
    await other.setContent(`<iframe src="${address}"></iframe>`);
    await other.waitForTimeout(500);
    check((await other.frames()[1].content()).includes('Cooke') === false, 'no frame shows it');
    await other.close();
    await page.waitForTimeout(4000);
    // A slider that the user set stays, though the page that comes at once has fewer steps.
    const slider = page.locator('#spots .steps input').first();
    await slider.fill('9');
    const times = [];
    for (let k = 0; k < 5; k++) {
      const name = `Edited ${k}`;
      const begun = performance.now();
      writeFileSync(file, text.replace(/^name = .*$/m, `name = "${name}"`));
      await page.waitForFunction(n => document.querySelector('h1')?.textContent === n, name, { polling: 5 });
      times.push(performance.now() - begun);
      await page.waitForTimeout(3000);
    }
    check((await slider.inputValue()) === '9', 'a slider stays where it was set');
    times.sort((a, b) => a - b);
    console.log(`view: a saved edit was on the page after ${times.map(t => t.toFixed(0)).join(', ')} ms`);
    writeFileSync(file, 'nonsense');
    await page.waitForSelector('#wrong');
    check((await page.textContent('h1')) === 'Edited 4', 'the last good page stays');
    writeFileSync(file, text);
    await page.waitForFunction(() => !document.querySelector('#wrong'));
    check(await page.locator('#value').count() === 1, 'the page\'s own script runs in later pages, too');
    await page.reload();
    await page.waitForFunction(() => document.querySelector('h1')?.textContent.startsWith('Cooke triplet'));
    // The address is its user's: what a link leads to does not learn it.
    check(await page.evaluate(() => document.cookie) === '', 'no cookies');
  } finally {
    server.kill();
  }
} finally {
  await browser.close();
  rmSync(folder, { recursive: true });
}
console.log(failures ? `${failures} failures` : 'pages in a browser: all as they should be');
process.exit(failures ? 1 : 0);
