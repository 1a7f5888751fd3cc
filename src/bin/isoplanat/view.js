// Keeps the page up to date: an event names the page that is shown now; where it is another than this one, its body takes the place of
// this one's, sliders stay where they are. One event at a time, only the last one counts.
(() => {
  const name = of => of.querySelector('meta[name=isoplanat-page]')?.content;
  let shown = name(document), news = null, away = false, busy = false;
  const banner = () => {
    const text = away ? 'The last page: the program that shows it does not answer.'
      : news?.error ? `The last good page; the file now: ${news.error}` : null;
    let box = document.getElementById('wrong');
    if (!text) { if (box) box.remove(); return; }
    if (!box) {
      box = document.createElement('div');
      box.id = 'wrong';
      box.setAttribute('role', 'alert');
      box.style = 'position:sticky;top:0;z-index:8;padding:.6rem .9rem;margin:0 0 1rem;border-radius:8px;background:#b3261e;color:#fff';
      document.body.prepend(box);
    }
    box.textContent = text;
  };
  const sliders = () => [...document.querySelectorAll('.steps input')];
  const replace = async () => {
    const text = await (await fetch('/', { cache: 'no-store' })).text();
    const next = new DOMParser().parseFromString(text, 'text/html');
    // By their part of the way: pages that come at once have fewer steps.
    const parts = sliders().map(s => s.value / (s.max || 1));
    const [x, y] = [scrollX, scrollY];
    shown = name(next);
    document.title = next.title;
    document.body.replaceWith(document.adoptNode(next.body));
    sliders().forEach((s, k) => { if (k < parts.length) s.value = Math.round(parts[k] * s.max); });
    for (const old of document.body.querySelectorAll('script')) {
      const script = document.createElement('script');
      script.textContent = old.textContent;
      old.replaceWith(script);
    }
    scrollTo(x, y);
    document.documentElement.dataset.page = shown;
  };
  const follow = async () => {
    if (busy) return;
    busy = true;
    try {
      for (let asked; news.page !== shown && news.page !== asked;) { asked = news.page; await replace(); }
    } catch { /* The stream of events tells that nobody answers. */ }
    busy = false;
    banner();
  };
  const source = new EventSource('/events');
  source.onmessage = event => { news = JSON.parse(event.data); follow(); };
  source.onerror = () => { away = true; banner(); };
  source.onopen = () => { away = false; banner(); };
})();
