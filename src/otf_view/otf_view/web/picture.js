// SPDX-License-Identifier: Apache-2.0
// Two drawings on canvas: the run in space, and distances along the run.
'use strict';

const FIRST_VIEW = { yaw: 0.7, pitch: 0.5 };
const view = { ...FIRST_VIEW };

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim();
}

function canvasOf(id) {
  const canvas = document.getElementById(id);
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext('2d');
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = '12px system-ui, "DejaVu Sans", sans-serif';
  return { pen, width, height };
}

// Orthographic view: Z up, turned about it by yaw, then tilted by pitch.
function projection(points, width, height) {
  const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw),
    Math.cos(view.pitch), Math.sin(view.pitch)];
  const low = [0, 1, 2].map(k => Math.min(...points.map(p => p[k])));
  const high = [0, 1, 2].map(k => Math.max(...points.map(p => p[k])));
  const middle = low.map((v, k) => (v + high[k]) / 2);
  const size = Math.hypot(...high.map((v, k) => v - low[k])) || 1;
  const zoom = 0.92 * Math.min(width, height) / size;
  return p => {
    const [x, y, z] = p.map((v, k) => v - middle[k]);
    const right = cy * x + sy * y, away = cy * y - sy * x;
    return [width / 2 + zoom * right, height / 2 - zoom * (cp * z + sp * away)];
  };
}

function strip(pen, points, style, width) {
  pen.strokeStyle = style;
  pen.lineWidth = width;
  pen.beginPath();
  points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function dot(pen, [x, y], style, radius) {
  pen.fillStyle = style;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fill();
}

function arrows(pen, at, begins, errors, factor, style) {
  begins.forEach((begin, k) => {
    const tip = begin.map((v, i) => v + 1e-6 * factor * errors[k][i]);
    strip(pen, [at(begin), at(tip)], style, 1.3);
    dot(pen, at(tip), style, 1.6);
  });
}

function axes(pen, at, path) {
  const low = [0, 1, 2].map(k => Math.min(...path.map(p => p[k])));
  const length = 0.2 * Math.max(...[0, 1, 2].map(k => Math.max(...path.map(p => p[k])) - low[k]));
  ['X', 'Y', 'Z'].forEach((name, k) => {
    const end = low.map((v, i) => v + (i === k ? length : 0));
    strip(pen, [at(low), at(end)], colour('soft'), 2);
    const [x, y] = at(end);
    pen.fillStyle = colour('soft');
    pen.fillText(name, x + 4, y - 4);
  });
}

function drawSpace(scene, now) {
  const { pen, width, height } = canvasOf('space');
  if (!scene || !scene.path) {
    pen.fillStyle = colour('soft');
    pen.fillText('waiting for the path', 12, 24);
    return;
  }
  const at = projection(scene.path, width, height);
  axes(pen, at, scene.path);
  strip(pen, scene.path.map(at), colour('path'), 1);
  pen.globalAlpha = 0.6;
  if (now && now.driven) strip(pen, now.driven.map(at), colour('driven'), 2);
  pen.globalAlpha = 1;
  if (scene.volume) {
    arrows(pen, at, scene.volume.points, scene.volume.errors_um, scene.volume.scale,
      colour('error'));
  }
  if (!now) return;
  arrows(pen, at, now.places, now.deviations_um, now.scale, colour('deviation'));
  if (now.tracker) {
    if (now.target) strip(pen, [at(now.tracker), at(now.target)], colour('beam'), 1.5);
    dot(pen, at(now.tracker), colour('beam'), 6);
  }
  if (now.target) dot(pen, at(now.target), colour('beam'), 4);
}

function niceStep(span, count) {
  const raw = span / count, decade = 10 ** Math.floor(Math.log10(raw));
  return decade * [1, 2, 5, 10].find(m => m * decade >= raw);
}

function drawPlot(scene, now) {
  const { pen, width, height } = canvasOf('plot');
  const lengths = now ? now.deviations_um.map(d => Math.hypot(...d)) : [];
  if (!lengths.length) return 0;
  const [left, bottom, top] = [44, height - 22, 10];
  const solved = scene && scene.solved ? scene.solved.mae_after_um : null;
  const most = 1.1 * Math.max(...lengths, solved || 0, 0.1);
  const x = k => left + (width - left - 8) * k / Math.max(1, lengths.length - 1);
  const y = v => bottom - (bottom - top) * v / most;
  const step = niceStep(most, 4);
  pen.fillStyle = colour('soft');
  for (let v = 0; v <= most; v += step) {
    strip(pen, [[left, y(v)], [width - 8, y(v)]], colour('line'), 1);
    pen.textAlign = 'right';
    pen.fillText(String(Number(v.toPrecision(3))), left - 6, y(v) + 4);
  }
  pen.textAlign = 'left';
  pen.fillText('µm', 4, top + 10);
  pen.fillText('start', left, height - 6);
  pen.textAlign = 'right';
  pen.fillText('now', width - 8, height - 6);
  pen.textAlign = 'left';
  lengths.forEach((v, k) => dot(pen, [x(k), y(v)], colour('deviation'), 1.8));
  if (solved !== null) strip(pen, [[left, y(solved)], [width - 8, y(solved)]], colour('driven'), 2);
  return lengths.length;
}
