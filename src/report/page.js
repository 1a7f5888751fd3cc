// Steps through drawings, values under the pointer, and what belongs to one field stands out everywhere.
(() => {
  for (const input of document.querySelectorAll('.steps input')) {
    const show = () => {
      for (const f of input.closest('.steps').querySelectorAll('figure')) f.hidden = f.dataset.k !== input.value;
    };
    input.addEventListener('input', show);
    show();
  }
  const light = key => {
    document.body.classList.toggle('lit', key !== '');
    for (const s of document.querySelectorAll('.s[data-key]')) s.classList.toggle('on', s.dataset.key === key);
  };
  const value = document.createElement('div');
  value.id = 'value';
  value.hidden = true;
  document.body.append(value);
  const hide = () => { value.hidden = true; light(''); };
  // The point of a series that is nearest to the pointer, in CSS pixels.
  const nearest = (svg, event) => {
    const to = svg.getScreenCTM();
    let best = { far: 40 };
    for (const s of svg.querySelectorAll('.s[data-v]')) {
      const line = s.querySelector('polyline');
      if (!line) continue;
      for (let k = 0; k < line.points.numberOfItems; k++) {
        const p = line.points.getItem(k).matrixTransform(to);
        const far = Math.hypot(p.x - event.clientX, p.y - event.clientY);
        if (far < best.far) best = { far, s, k };
      }
    }
    return best;
  };
  for (const svg of document.querySelectorAll('svg[data-x]')) {
    const move = event => {
      const { s, k } = nearest(svg, event);
      if (!s) { hide(); return; }
      const [x, y] = s.dataset.v.split(' ')[k].split(',');
      value.textContent = `${s.dataset.name}\n${svg.dataset.x}: ${x}\n${svg.dataset.y}: ${y}`.trim();
      value.hidden = false;
      const box = value.getBoundingClientRect();
      value.style.left = `${Math.max(4, Math.min(event.clientX + 14, innerWidth - box.width - 4))}px`;
      value.style.top = `${Math.max(4, event.clientY - box.height - 12)}px`;
      light(s.dataset.key || '');
    };
    svg.addEventListener('pointermove', move);
    svg.addEventListener('pointerdown', move);
    svg.addEventListener('pointerleave', hide);
  }
  for (const s of document.querySelectorAll('.s[data-key]:not([data-v])')) {
    s.addEventListener('pointerenter', () => light(s.dataset.key));
    s.addEventListener('pointerleave', () => light(''));
  }
})();
