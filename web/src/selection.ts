// Which trajectories are selected: the last one is the one that is spoken of, the one before it the other of a pair.

export type Selection = readonly number[];

export function chosen(selection: Selection, slot: number, add: boolean): Selection {
  if (!add) return selection.length === 1 && selection[0] === slot ? selection : [slot];
  return selection.includes(slot) ? selection.filter((s) => s !== slot) : [...selection, slot];
}

/** The trajectory that is spoken of. */
export const main = (selection: Selection): number | null => selection.at(-1) ?? null;

/** The other of a pair, where two are selected. */
export const other = (selection: Selection): number | null => (selection.length === 2 ? selection[0] : null);

/** The trajectory before or after the main one, among those that have samples. */
export function neighbour(selection: Selection, order: readonly number[], step: number): Selection {
  if (order.length === 0) return [];
  const at = order.indexOf(main(selection) ?? -1);
  if (at < 0) return [order[step > 0 ? 0 : order.length - 1]];
  return [order[(at + step + order.length) % order.length]];
}

/** What is still there after the take was changed. */
export const remaining = (selection: Selection, present: ReadonlySet<number>): Selection =>
  selection.every((s) => present.has(s)) ? selection : selection.filter((s) => present.has(s));
