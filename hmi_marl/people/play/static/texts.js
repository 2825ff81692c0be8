// Texts of the page, as the server gave them.
const known = JSON.parse(document.body.dataset.texts);

export function t(key, values = {}) {
  return known[key].replace(/{(\w+)}/g, (_, name) => String(values[name]));
}
