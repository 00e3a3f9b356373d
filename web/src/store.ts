// Values that tell who looks at them when they change.

export interface Signal<T> {
  get(): T;
  set(value: T): void;
  update(change: (value: T) => T): void;
  on(listener: (value: T) => void): () => void;
}

export function signal<T>(initial: T): Signal<T> {
  let value = initial;
  const listeners = new Set<(value: T) => void>();
  return {
    get: () => value,
    set(next) {
      if (Object.is(next, value)) return;
      value = next;
      for (const listener of [...listeners]) listener(next);
    },
    update(change) {
      this.set(change(value));
    },
    on(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}

/** Run `work` once after any of some signals changed, however many of them and however often. */
export function after(signals: Pick<Signal<unknown>, "on">[], work: () => void): void {
  let due = false;
  const plan = () => {
    if (due) return;
    due = true;
    queueMicrotask(() => {
      due = false;
      work();
    });
  };
  for (const one of signals) one.on(plan);
}
