// SPDX-License-Identifier: Apache-2.0
// Asks the server for the state of the run and shows it.
'use strict';

const KIND = { WAITING_FOR_PATH: 'wait', BUFFERING: 'work', ALIGNING: 'work', SOLVING: 'work',
  DONE: 'good', FAILED: 'bad' };
const SAID = { WAITING_FOR_PATH: 'waiting for the path', BUFFERING: 'collecting samples',
  ALIGNING: 'aligning', SOLVING: 'solving', DONE: 'done', FAILED: 'failed' };
const ROWS = [
  ['positioning', a => `E${a}${a}`],
  ['straightness', a => `E${'XYZ'.replace(a, '')[0]}${a}`],
  ['straightness', a => `E${'XYZ'.replace(a, '')[1]}${a}`],
  ['rotation about X', a => `EA${a}`], ['rotation about Y', a => `EB${a}`],
  ['rotation about Z', a => `EC${a}`]];

let scene = null, now = null;

const byId = id => document.getElementById(id);
const micro = words => words.replace(/(^|[^\w])u(m|rad)(?!\w)/g, '$1µ$2').replace(/\+\/-/g, '±');
const text = (id, words) => { byId(id).textContent = micro(words); };

function badge(id, kind, words) {
  byId(id).className = 'badge ' + kind;
  text(id, words);
}

function um(value) {
  return value === null ? '–' : value.toPrecision(value >= 100 ? 4 : 3) + ' µm';
}

function duration(seconds) {
  const s = Math.round(seconds), minutes = Math.floor(s / 60);
  if (minutes >= 60) return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
  return minutes ? `${minutes} min ${s % 60} s` : `${s} s`;
}

function showNow() {
  badge('state', KIND[now.state] || 'wait', SAID[now.state] || 'no state yet');
  const percent = Math.round(100 * now.fraction);
  text('done', now.state ? `${percent} %` : '');
  text('left', now.time_left === null ? '' : `about ${duration(now.time_left)} left`);
  byId('fill').style.width = percent + '%';
  byId('fill').parentNode.setAttribute('aria-valuenow', percent);
  text('message', now.message);
  text('driven', now.length === null ? '–'
    : `${now.travelled.toFixed(1)} of ${now.length.toFixed(1)} m`);
  const named = now.target_name ? `, target ${now.target_name}` : '';
  text('part', now.parts > 1 ? `${now.part} of ${now.parts}${named}` : '–');
  text('samples', now.samples.toLocaleString('en'));
  text('rate', now.rate === null ? '–' : `${Math.round(now.rate)} per second`);
  const share = now.samples + now.lost ? 100 * now.lost / (now.samples + now.lost) : 0;
  text('lost', now.lost.toLocaleString('en') + (now.lost ? ` (${share.toFixed(1)} %)` : ''));
  byId('lost').className = now.lost ? 'bad' : '';
  text('distance', um(now.distance_um));
  text('place', now.tracker === null ? 'not known yet'
    : now.tracker.map(v => v.toFixed(3)).join(', ') + ' m');
  const shown = [];
  if (now.places.length) shown.push(scaled('deviations', now.scale));
  if (scene && scene.volume) shown.push(scaled('predicted errors', scene.volume.scale));
  text('scales', shown.join('; '));
}

function scaled(what, factor) {
  return `${what} × ${factor.toLocaleString('en')}: 10 mm stand for ` +
    `${Number((1e4 / factor).toPrecision(3))} µm`;
}

function figure(name, value) {
  const box = document.createElement('div');
  for (const [tag, words] of [['dt', name], ['dd', value]]) {
    box.appendChild(document.createElement(tag)).textContent = words;
  }
  return box;
}

function showSolved() {
  const solved = scene.solved;
  const soFar = Boolean(solved && scene.volume && scene.volume.provisional);
  text('solved_title', soFar ? 'Result so far' : 'Result');
  byId('motions').hidden = !solved || !Object.keys(solved.motions).length;
  byId('warnings').replaceChildren();
  byId('figures').replaceChildren();
  if (!solved) {
    byId('alert').hidden = true;
    text('solved', 'Errors come at the end of the run.');
    return;
  }
  text('solved', solved.message);
  byId('alert').hidden = solved.ok;
  text('alert', solved.message);
  byId('solved').className = solved.ok ? '' : 'bad';
  for (const words of solved.warnings) {
    byId('warnings').appendChild(document.createElement('li')).textContent = micro(words);
  }
  if (byId('motions').hidden) return;
  const figures = [['from the path, as it is', um(solved.mae_before_um)],
    ['compensated', um(solved.mae_after_um)], ['residual, rms', um(solved.residual_rms_um)]];
  if (scene.volume) {
    figures.push(['predicted in the volume, mean', um(scene.volume.mean_um)]);
  }
  byId('figures').replaceChildren(...figures.map(([name, value]) => figure(name, value)));
  badge('which', soFar ? 'work' : 'good', soFar ? 'so far' : 'final');
  showMotions(solved);
}

function cell(name, found) {
  const box = document.createElement('td');
  box.appendChild(document.createElement('b')).textContent = name + ' ';
  const value = box.appendChild(document.createElement('span'));
  const [error, u] = found || [null, null];
  if (u === null) {
    value.className = 'unknown';
    value.textContent = 'not known';
  } else {
    value.className = Math.abs(error) < 2 * u ? 'weak' : '';
    value.textContent = `${error.toFixed(1)} ± ${u < 0.1 ? u.toFixed(2) : u.toFixed(1)}`;
  }
  return box;
}

function row(label, cells) {
  const line = document.createElement('tr');
  const head = line.appendChild(document.createElement('th'));
  head.scope = 'row';
  head.textContent = label;
  line.append(...cells);
  return line;
}

function showMotions(solved) {
  const rows = ROWS.map(([label, name]) => row(label, [...'XYZ'].map(a =>
    cell(name(a), solved.motions[name(a)]))));
  const squareness = ['C0Y', 'B0Z', 'A0Z'].map(name => cell(name, solved.squareness[name]));
  byId('rows').replaceChildren(...rows, row('squareness', squareness), ...rotaryRows(solved));
}

function rotaryRows(solved) {
  const letters = [...'ABC'].filter(a => `EX${a}` in solved.motions);
  return letters.flatMap(a => [
    row(`${a}: translations`, [...'XYZ'].map(d => cell(`E${d}${a}`, solved.motions[`E${d}${a}`]))),
    row(`${a}: rotations`, [...'ABC'].map(d => cell(`E${d}${a}`, solved.motions[`E${d}${a}`]))),
    ...['XYZ', 'ABC'].map(kind => {
      const names = [...kind].map(d => `${d}0${a}`).filter(name => name in solved.location);
      const what = kind === 'XYZ' ? 'position of the axis' : 'orientation of the axis';
      return row(`${a}: ${what}`, names.map(name => cell(name, solved.location[name])));
    })]);
}

function draw() {
  drawSpace(scene, now);
  const count = drawPlot(scene, now);
  const solved = scene && scene.solved && scene.solved.mae_after_um !== null;
  text('plotted', !count ? 'Shown once the tracker position is known.'
    : 'Dots: measured along the run.' + (solved ? ' Line: mean that compensation leaves.' : ''));
}

async function ask() {
  try {
    const told = await (await fetch('state.json')).json();
    const news = JSON.stringify(told.scene) !== JSON.stringify(scene);
    scene = told.scene || null;
    now = told.now || null;
    if (news) showSolved();
    if (now) showNow();
    draw();
    byId('report').href = told.report || '';
    byId('offered').hidden = !told.report || told.ended;  // nobody serves it any more
    badge('link', ...(told.ended
      ? ['wait', 'the nodes have ended; this is the last they reported'] : ['good', 'live']));
    if (told.ended) return;
  } catch {
    badge('link', 'bad', 'no connection; trying again');
  }
  setTimeout(ask, 500);
}

function turning() {
  const canvas = byId('space');
  canvas.addEventListener('pointerdown', e => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener('pointermove', e => {
    if (!canvas.hasPointerCapture(e.pointerId)) return;
    turn(0.01 * e.movementX, 0.01 * e.movementY);
  });
  canvas.addEventListener('dblclick', () => { Object.assign(view, FIRST_VIEW); draw(); });
  canvas.addEventListener('keydown', e => {
    const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1],
      ArrowDown: [0, 0.1] }[e.key];
    if (by) { e.preventDefault(); turn(...by); }
  });
}

function turn(yaw, pitch) {
  view.yaw += yaw;
  view.pitch = Math.max(-1.57, Math.min(1.57, view.pitch + pitch));
  draw();
}

window.addEventListener('resize', draw);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw);
turning();
draw();
ask();
