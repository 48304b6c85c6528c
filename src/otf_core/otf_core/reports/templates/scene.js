// SPDX-License-Identifier: Apache-2.0
// Turns every scene of a page with mouse, finger or arrow keys; needs nothing else.
'use strict';
for (const svg of document.querySelectorAll('svg.turn')) {
  const items = JSON.parse(svg.dataset.scene);
  const marks = [...svg.children].slice(-items.length);
  const box = svg.viewBox.baseVal, half = box.height / 2 - 22;
  const front = [-58 * Math.PI / 180, 24 * Math.PI / 180];
  let [azimuth, elevation] = front, last = null;
  const draw = () => {
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth);
    const ce = Math.cos(elevation), se = Math.sin(elevation);
    const at = (v, i) => [box.width / 2 + half * (-sa * v[i] + ca * v[i + 1]),
      box.height / 2 - half * (-ca * se * v[i] - sa * se * v[i + 1] + ce * v[i + 2])];
    const text = p => p[0].toFixed(1) + ' ' + p[1].toFixed(1);
    items.forEach((v, k) => {
      const mark = marks[k];
      if (v[0] === 3) {
        const p = at(v, 1);
        mark.setAttribute('x', p[0].toFixed(1)); mark.setAttribute('y', p[1].toFixed(1));
        return;
      }
      let d = '';
      for (let i = 1; i < v.length; i += v[0] ? 6 : 3) {
        const a = at(v, i);
        if (!v[0]) { d += 'M' + text(a) + 'h0'; continue; }
        const b = at(v, i + 3);
        d += 'M' + text(a) + 'L' + text(b);
        if (v[0] === 2) {
          const s = [a[0] - b[0], a[1] - b[1]], n = Math.max(Math.hypot(...s), 1e-9);
          const f = Math.min(5, 0.6 * n) / n, c = Math.cos(0.45), t = Math.sin(0.45);
          const side = u => text([b[0] + f * (c * s[0] - u * t * s[1]),
            b[1] + f * (u * t * s[0] + c * s[1])]);
          d += 'M' + side(1) + 'L' + text(b) + 'L' + side(-1);
        }
      }
      mark.setAttribute('d', d);
    });
  };
  const turn = (right, down) => {
    azimuth -= right;
    elevation = Math.max(-1.5, Math.min(1.5, elevation + down));
    draw();
  };
  svg.addEventListener('pointerdown', e => { last = [e.clientX, e.clientY];
    svg.setPointerCapture(e.pointerId); });
  svg.addEventListener('pointermove', e => {
    if (!last) return;
    turn((e.clientX - last[0]) / 150, (e.clientY - last[1]) / 150);
    last = [e.clientX, e.clientY];
  });
  for (const end of ['pointerup', 'pointercancel']) svg.addEventListener(end, () => last = null);
  const steps = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1],
    ArrowDown: [0, 0.1]};
  svg.addEventListener('keydown', e => {
    if (e.key === 'Home') [azimuth, elevation] = front;
    else if (!(e.key in steps)) return;
    e.preventDefault();
    turn(...(steps[e.key] || [0, 0]));
  });
}
