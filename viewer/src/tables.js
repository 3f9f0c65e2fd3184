// Tables that a click on a column's head sorts, numbers by value.

const number = (text) => {
  const trimmed = text.trim();
  return trimmed === '' || trimmed === '–' ? Infinity : Number(trimmed);
};

function order(a, b) {
  const [x, y] = [number(a), number(b)];
  if (!Number.isNaN(x) && !Number.isNaN(y)) return x === y ? 0 : x - y;
  return a.localeCompare(b, undefined, { numeric: true });
}

export function sortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement('button');
    button.type = 'button';
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener('click', () => {
      const direction = head.ariaSort === 'ascending' ? -1 : 1;
      heads.forEach((other) => other.removeAttribute('aria-sort'));
      head.ariaSort = direction === 1 ? 'ascending' : 'descending';
      const [body] = table.tBodies;
      const cell = (row) => row.cells[column].textContent;
      body.append(...[...body.rows].sort((a, b) => direction * order(cell(a), cell(b))));
    });
  });
}
