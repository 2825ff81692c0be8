// What of a page leaves its box or the page, is cut off, or is not shown; run by browsing.py.
() => {
  const problems = [], page = document.scrollingElement, width = window.innerWidth;
  const name = (e) => {
    const id = e.id ? '#' + e.id : '', kind = e.className?.baseVal ?? e.className ?? '';
    return `<${e.tagName.toLowerCase()}${id} class="${kind}"> ${(e.textContent || '').trim().slice(0, 60)}`;
  };
  const scrolls = (e) => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX);
  const scroller = (e) => { while (e && !scrolls(e)) e = e.parentElement; return e; };
  if (page.scrollWidth > width) problems.push(`the page is ${page.scrollWidth} wide`);
  const main = document.querySelector('article') || document.body;
  for (const e of main.querySelectorAll('*')) {
    const box = e.getBoundingClientRect(), style = getComputedStyle(e);
    if (!box.width || !box.height || style.visibility === 'hidden') continue;
    const around = scroller(e === main ? e : e.parentElement);
    const outside = box.right > width + 1 || box.left < -1;
    if (outside && (!around || around === page || around === document.body))
      problems.push(`leaves the page (${Math.round(box.left)} to ${Math.round(box.right)}): ${name(e)}`);
    const hides = (overflow) => ['hidden', 'clip'].includes(overflow);
    const small = box.width < 3 || style.position === 'absolute';  // for screen readers
    if (!small && e.textContent.trim()) {
      if (hides(style.overflowX) && e.scrollWidth > e.clientWidth + 1)
        problems.push(`cut off (${e.scrollWidth} in ${e.clientWidth}): ${name(e)}`);
      if (hides(style.overflowY) && e.scrollHeight > e.clientHeight + 2)
        problems.push(`cut off below (${e.scrollHeight} in ${e.clientHeight}): ${name(e)}`);
    }
    if (['TD', 'TH', 'CODE', 'PRE', 'TABLE', 'math'].includes(e.tagName)
        && style.display !== 'inline' && !scrolls(e) && e.scrollWidth > e.clientWidth + 1
        && e.clientWidth)
      problems.push(`overflows its box (${e.scrollWidth} in ${e.clientWidth}): ${name(e)}`);
  }
  for (const e of main.querySelectorAll('td, th')) {
    const text = e.textContent.trim(), range = document.createRange();
    range.selectNodeContents(e);  // its own height, not that of its row
    const lines = range.getBoundingClientRect().height / (parseFloat(getComputedStyle(e).fontSize) * 1.6);
    if (text && lines > 6 && text.length / lines < 4)  // a picture alone is no text
      problems.push(`is a column of letters (${e.clientWidth} wide): ${name(e)}`);
  }
  for (const image of main.querySelectorAll('img'))
    if (!image.complete || !image.naturalWidth) problems.push(`is not shown: ${image.src.slice(0, 80)}`);
  return problems;
}
