// Small helpers for elements. Text from data is only ever set as text.

export const byId = (id) => document.getElementById(id);

/** Creates an element with properties and children. */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in element) element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Creates a row of a form: a label and its controls. */
export function row(label, id, ...controls) {
  return make('div', { className: 'row' }, make('label', { htmlFor: id }, label), ...controls);
}

/** Saves bytes as a file. */
export function save(name, type, ...parts) {
  const url = URL.createObjectURL(new Blob(parts, { type }));
  make('a', { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Converts a name to one that every file system accepts. */
export function fileName(name) {
  return name.replace(/[^\p{L}\p{N}._-]+/gu, '_').slice(0, 80) || 'surface';
}
