// Making elements.

type Child = Node | string | null | undefined | false;
type Properties = Record<string, unknown>;

/** An element with properties (`onclick`, `className`, …: handlers must not return false, which would stop the event; `aria-*`, `data-*` and `for` as attributes) and children. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (/^(aria-|data-|for$|role$|list$)/.test(name)) made.setAttribute(name, String(value));
    else Object.assign(made, { [name]: value });
  }
  made.append(...children.filter((c): c is Node | string => c instanceof Node || typeof c === "string"));
  return made;
}

export const button = (text: string, onclick: () => void, properties: Properties = {}): HTMLButtonElement =>
  h("button", { type: "button", onclick, ...properties }, text);

export function select(label: string, choices: Record<string, string>, value: string, changed: (v: string) => void) {
  const made = h(
    "select",
    { "aria-label": label, onchange: () => changed(made.value) },
    ...Object.entries(choices).map(([v, text]) => h("option", { value: v, selected: v === value }, text)),
  );
  return made;
}

/** Children in place of those that are there; what was focused stays so where it has an id. */
export function fill(host: HTMLElement, ...children: Child[]): void {
  const focused = host.contains(document.activeElement) ? document.activeElement!.id : "";
  host.replaceChildren(...children.filter((c): c is Node | string => c instanceof Node || typeof c === "string"));
  if (focused) document.getElementById(focused)?.focus();
}
