// Keeps the page up to date: an event names the page that is shown now; where it is another than this one, its body takes the place of
// this one's, sliders stay where they are. One event at a time, only the last one counts. The server wants the token of the page's address.
(() => {
  const name = of => of.querySelector('meta[name=isoplanat-page]')?.content;
  const at = path => path + location.search;
  const SILENT = 'The last page: the program that shows it does not answer.';
  const ANOTHER = 'The last page: the program was started again since, and printed another address.';
  let shown = name(document), news = null, away = null, busy = false;
  const banner = () => {
    const text = away ?? (news?.error ? `The last good page; the file now: ${news.error}` : null);
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
  // What the user set, as a part of the way: pages that come at once have fewer steps, and fewer sliders.
  const kept = new Map();
  const what = s => `${s.closest('section')?.id}|${s.closest('label')?.textContent}|`
    + s.closest('.steps').querySelector('svg')?.getAttribute('aria-label')?.split(/[-0-9]/)[0];
  document.addEventListener('input', e => {
    if (e.target.matches?.('.steps input')) kept.set(what(e.target), e.target.value / (e.target.max || 1));
  }, true);
  const replace = async () => {
    const answer = await fetch(at('/'), { cache: 'no-store' });
    if (!answer.ok) throw new Error(answer.statusText);
    const next = new DOMParser().parseFromString(await answer.text(), 'text/html');
    const [x, y] = [scrollX, scrollY];
    shown = name(next);
    document.title = next.title;
    document.body.replaceWith(document.adoptNode(next.body));
    for (const s of sliders()) {
      const part = kept.get(what(s));
      if (part !== undefined) s.value = Math.round(part * s.max);
    }
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
    } catch {
      // The stream of events tells that nobody answers; who is busy is asked again.
      setTimeout(follow, 1000);
    }
    busy = false;
    banner();
  };
  const listen = () => {
    const source = new EventSource(at('/events'));
    source.onmessage = event => { news = JSON.parse(event.data); follow(); };
    source.onerror = async () => {
      away = SILENT;
      banner();
      if (source.readyState !== EventSource.CLOSED) return;
      // An answer that is no stream closes it for good; a refusal is another run's, which has another token.
      const answer = await fetch(at('/'), { cache: 'no-store' }).catch(() => null);
      if (answer?.status === 403) { away = ANOTHER; banner(); } else setTimeout(listen, 1000);
    };
    source.onopen = () => { away = null; banner(); };
  };
  listen();
})();
