import { beforeEach, describe, expect, it, vi } from "vitest";

const kept = new Map<string, string>();
vi.stubGlobal("localStorage", {
  getItem: (key: string) => kept.get(key) ?? null,
  setItem: (key: string, value: string) => kept.set(key, value),
  removeItem: (key: string) => kept.delete(key),
});

class ServerError extends Error {
  constructor(
    readonly kind: string,
    message: string,
  ) {
    super(message);
  }
}
const api = { edit: vi.fn(), at: vi.fn(), undo: vi.fn(), redo: vi.fn() };
const refresh = vi.fn();
vi.doMock("../src/api", () => ({ api, ServerError }));
vi.doMock("../src/open", () => ({ refresh }));
const mend = await import("../src/mend");
const state = await import("../src/state");
const WAITING = "markerloom.waiting";

beforeEach(() => {
  kept.clear();
  for (const f of [...Object.values(api), refresh]) f.mockReset();
  api.edit.mockResolvedValue({ message: "done" });
  api.at.mockImplementation(async (_: string, slot: number, frame: number) => ({ frame, xyz_mm: [slot, 0, 0] }));
  const take = { name: "walk", revision: 7, first_frame: 100, frames: 50, trajectories: [] };
  state.take.set(take as unknown as ReturnType<typeof state.take.get>);
  state.row.set(20);
  state.selection.set([2, 5]);
  state.range.set({ first: 10, last: 19 });
});

describe("edits", () => {
  it("name frames by their numbers, and markers by a place that the server finds", async () => {
    await mend.swap();
    expect(api.edit).toHaveBeenCalledWith("walk", 7, {
      op: "swap",
      at: { frame: 120, xyz_mm: [5, 0, 0] },
      other: { frame: 120, xyz_mm: [2, 0, 0] },
      within: { first: 110, last: 119 },
    });
    expect(refresh).toHaveBeenCalledWith("walk");
    expect(state.status.get()).toEqual({ text: "done", bad: false });
    expect(state.busy.get()).toBe(0);
  });

  it("are about the whole take where no frames are selected, and delete nothing then", async () => {
    state.range.set(null);
    await mend.label("HEAD");
    expect(api.edit.mock.calls[0][2]).toMatchObject({ op: "label", name: "HEAD", within: null });
    expect(mend.within()).toEqual({ first: 100, last: 149 });
    await mend.remove();
    expect(api.edit).toHaveBeenCalledTimes(1);
    expect(state.status.get().text).toContain("Select frames first");
  });

  it("need a marker, or two", async () => {
    state.selection.set([2]);
    await mend.swap();
    state.selection.set([]);
    await mend.unlabel();
    expect(api.edit).not.toHaveBeenCalled();
    expect(state.status.get().text).toContain("Select a marker first");
  });

  it("wait in the browser while the server is gone, and are made once when it is back", async () => {
    api.at.mockRejectedValue(new ServerError("offline", "gone"));
    await mend.label("HEAD");
    expect(state.status.get()).toMatchObject({ bad: true });
    expect(JSON.parse(kept.get(WAITING)!)).toMatchObject({ take: "walk", edit: { op: "label", name: "HEAD" } });
    await mend.retryWaiting();
    expect(kept.has(WAITING)).toBe(true);
    api.at.mockResolvedValue({ frame: 120, xyz_mm: [5, 0, 0] });
    await mend.retryWaiting();
    expect(api.edit).toHaveBeenCalledTimes(1);
    expect(kept.has(WAITING)).toBe(false);
    await mend.retryWaiting();
    expect(api.edit).toHaveBeenCalledTimes(1);
  });

  it("of another take wait until that is open again", async () => {
    kept.set(WAITING, JSON.stringify({ take: "run", revision: 1, edit: { op: "unlabel" } }));
    await mend.retryWaiting();
    expect(api.edit).not.toHaveBeenCalled();
    expect(kept.has(WAITING)).toBe(true);
  });

  it("that come too late are told, and the take is shown as it is", async () => {
    api.edit.mockRejectedValue(new ServerError("conflict", "changed in another window"));
    await mend.unlabel();
    expect(refresh).toHaveBeenCalledWith("walk");
    expect(state.status.get()).toEqual({ text: "changed in another window", bad: true });
    expect(kept.has(WAITING)).toBe(false);
  });
});
