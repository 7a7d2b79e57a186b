"use strict";

/** A table whose columns sort: {title, digits or text, of(row), cell(row)}. */
function sortable(rows, columns, sortBy) {
  const body = make("tbody");
  const heads = columns.map((column) => {
    const head = make("th", { scope: "col", class: column.text ? null : "number" });
    if (column.of) head.append(make("button", { type: "button", onclick: () => sort(column, head) }, column.title));
    else head.append(column.title);
    return head;
  });
  const filled = rows.map((row) => make("tr", {}, ...columns.map((column) => make(
    "td", { class: column.text ? null : "number" },
    column.cell ? column.cell(row) : column.text ? String(column.of(row)) : shown(column.of(row), column.digits),
  ))));
  const order = rows.map((_, i) => i);

  function sort(column, head) {
    const up = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up === 1 ? "ascending" : "descending");
    order.sort((a, b) => up * compare(column.of(rows[a]), column.of(rows[b])) || a - b);
    body.replaceChildren(...order.map((i) => filled[i]));
  }

  body.append(...filled);
  const table = make("table", {}, make("thead", {}, make("tr", {}, ...heads)), body);
  if (sortBy) sort(sortBy, heads[columns.indexOf(sortBy)]);
  return { table, rows: filled };
}

function compare(a, b) {
  if (typeof a === "string") return a.localeCompare(b);
  return (a ?? -Infinity) - (b ?? -Infinity);
}
