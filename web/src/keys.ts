// Keys as they are written in the list of shortcuts.

/** How an event is written in the list above. */
export function written(event: Pick<KeyboardEvent, "key" | "ctrlKey" | "metaKey" | "shiftKey">): string {
  const key = event.key === " " ? "Space" : event.key;
  const letter = /^[A-Za-z]$/.test(key);
  const shift = event.shiftKey && (letter || key.length > 1) ? "Shift+" : "";
  return `${event.ctrlKey || event.metaKey ? "Ctrl+" : ""}${shift}${key}`;
}
