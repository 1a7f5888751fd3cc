// Keeps the page up to date: an event tells of another version, whose body takes the place of this one; sliders stay where they are.
(() => {
  let version = null;
  const banner = text => {
    let box = document.getElementById('wrong');
    if (!text) { if (box) box.remove(); return; }
    if (!box) {
      box = document.createElement('div');
      box.id = 'wrong';
      box.setAttribute('role', 'alert');
      box.style = 'position:sticky;top:0;z-index:8;padding:.6rem .9rem;margin:0 0 1rem;border-radius:8px;background:#b3261e;color:#fff';
      document.body.prepend(box);
    }
    box.textContent = `The last good page; the file now: ${text}`;
  };
  const sliders = () => [...document.querySelectorAll('.steps input')];
  const replace = async () => {
    const text = await (await fetch('/', { cache: 'no-store' })).text();
    const next = new DOMParser().parseFromString(text, 'text/html');
    const values = sliders().map(s => s.value);
    const [x, y] = [scrollX, scrollY];
    document.title = next.title;
    document.body.replaceWith(document.adoptNode(next.body));
    sliders().forEach((s, k) => { if (k < values.length) s.value = values[k]; });
    for (const old of document.body.querySelectorAll('script')) {
      const script = document.createElement('script');
      script.textContent = old.textContent;
      old.replaceWith(script);
    }
    scrollTo(x, y);
    document.documentElement.dataset.version = version;
  };
  const source = new EventSource('/events');
  source.onmessage = async event => {
    const news = JSON.parse(event.data);
    const other = version !== null && news.version !== version && !news.error;
    version = news.version;
    if (other) await replace();
    banner(news.error);
  };
  source.onerror = () => banner('the program that shows this page has ended');
  source.onopen = () => banner(null);
})();
