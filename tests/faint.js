// Texts of a page whose contrast with what is behind them is below that of WCAG's level AA; run by browsing.py.
() => {
  const numbers = (colour) => (colour.match(/[\d.]+/g) || []).map(Number);
  const light = (colour) => {
    const [r, g, b] = numbers(colour).slice(0, 3).map((v) => v / 255)
      .map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const plain = (colour) => /^rgb/.test(colour) && (numbers(colour)[3] ?? 1) > 0.95;
  const found = {}, texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode.textContent.trim(), e = texts.currentNode.parentElement;
    const style = getComputedStyle(e);
    const shown = e.checkVisibility({ opacityProperty: true, visibilityProperty: true });
    if (!text || !shown || !e.getBoundingClientRect().width) continue;
    let behind = e;
    while (behind && !plain(getComputedStyle(behind).backgroundColor)) behind = behind.parentElement;
    if (!behind || !plain(style.color)) continue;  // what shines through is not judged
    const [low, high] = [light(style.color), light(getComputedStyle(behind).backgroundColor)].sort((a, b) => a - b);
    const contrast = (high + 0.05) / (low + 0.05), least = parseFloat(style.fontSize) >= 24 ? 3 : 4.5;
    if (contrast < least) found[`${e.tagName} ${e.className} ${style.color}`] ??= `is faint (${contrast.toFixed(2)}): ${text.slice(0, 60)}`;
  }
  return Object.values(found);
}
