// Talking to the server: every call carries the token; what goes wrong comes back as words.

import { type EmbeddedTake, embeddedApi } from "./embedded";
import type {
  AccuracyView,
  At,
  CoverageView,
  Done,
  DotsView,
  EditRequest,
  ExportRequest,
  Findings,
  MarkerSetView,
  Notice,
  Preview,
  Problem,
  ProjectView,
  RefinedView,
  Series,
  SubjectEdit,
  SubjectRequest,
  SubjectView,
  Suggestion,
  TakeInfo,
  TakeView,
  Timeline,
  Why,
} from "./wire";

const token = new URLSearchParams(location.search).get("token") ?? "";

export type Edit = EditRequest["edit"];

export class ServerError extends Error {
  constructor(
    readonly kind: Problem["error"] | "offline",
    message: string,
  ) {
    super(message);
  }
}

async function send(method: string, path: string, body?: unknown): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(`api/${path}`, {
      method,
      headers: { "X-Markerloom-Token": token, ...(body === undefined ? {} : { "Content-Type": "application/json" }) },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    throw new ServerError("offline", "The server does not answer. It is tried again; nothing is lost.");
  }
  if (answer.ok) return answer;
  const said: Problem = await answer.json().catch(() => ({ error: "failed", message: `answer ${answer.status}` }));
  throw new ServerError(said.error, said.message);
}

async function json<T>(method: string, path: string, body?: unknown): Promise<T> {
  return (await send(method, path, body)).json();
}

const of = (take: string) => `takes/${encodeURIComponent(take)}`;
const get = <T>(path: string) => json<T>("GET", path);
const bytes = async (path: string) => (await send("GET", path)).arrayBuffer();

const server = {
  project: () => get<ProjectView>("project"),
  open: (take: string) => json<TakeInfo>("POST", `${of(take)}/open`),
  reopen: (take: string) => json<TakeInfo>("POST", `${of(take)}/reopen`),
  process: (take: string) => json<TakeInfo>("POST", `${of(take)}/process`),
  take: (take: string) => get<TakeView>(of(take)),
  timeline: (take: string) => get<Timeline>(`${of(take)}/timeline`),
  chunk: (take: string, first: number, count: number) => bytes(`${of(take)}/chunk?first=${first}&count=${count}`),
  overview: (take: string) => bytes(`${of(take)}/overview`),
  joints: (take: string, first: number, count: number) => bytes(`${of(take)}/joints?first=${first}&count=${count}`),
  series: (take: string, slot: number, first: number, last: number, bins: number) =>
    get<Series>(`${of(take)}/series?slot=${slot}&first=${first}&last=${last}&bins=${bins}`),
  jointSeries: (take: string, joint: number, first: number, last: number, bins: number) =>
    get<Series>(`${of(take)}/joint-series?joint=${joint}&first=${first}&last=${last}&bins=${bins}`),
  dots: (take: string, frame: number) => get<DotsView>(`${of(take)}/dots?frame=${frame}`),
  video: async (take: string, camera: string, frame: number) =>
    (await send("GET", `${of(take)}/video?camera=${encodeURIComponent(camera)}&frame=${frame}`)).blob(),
  coverage: (take: string) => get<CoverageView[]>(`${of(take)}/coverage`),
  accuracy: (take: string) => get<AccuracyView>(`${of(take)}/accuracy`),
  refined: (take: string) => get<RefinedView>(`${of(take)}/refined`),
  why: (take: string, slot: number, frame: number) => get<Why>(`${of(take)}/why?slot=${slot}&frame=${frame}`),
  findings: (take: string) => get<Findings>(`${of(take)}/findings`),
  suggestions: (take: string, slot: number) => get<Suggestion[]>(`${of(take)}/suggestions?slot=${slot}`),
  previews: (take: string, slot: number, first: number, last: number) =>
    get<Preview[]>(`${of(take)}/previews?slot=${slot}&first=${first}&last=${last}`),
  at: (take: string, slot: number, frame: number) => get<At>(`${of(take)}/at?slot=${slot}&frame=${frame}`),
  edit: (take: string, revision: number, edit: Edit) => json<Done>("POST", `${of(take)}/edits`, { revision, edit }),
  undo: (take: string, revision: number) => json<Done>("POST", `${of(take)}/undo`, { revision }),
  redo: (take: string, revision: number) => json<Done>("POST", `${of(take)}/redo`, { revision }),
  export: (take: string, wanted: ExportRequest) => json<Done>("POST", `${of(take)}/export`, wanted),
  markerSets: () => get<string[]>("marker-sets"),
  markerSet: (name: string) => get<MarkerSetView>(`marker-sets/${encodeURIComponent(name)}`),
  saveMarkerSet: (name: string, view: MarkerSetView) =>
    json<Done>("PUT", `marker-sets/${encodeURIComponent(name)}`, view),
  learnSubject: (take: string, wanted: SubjectRequest) => json<Done>("POST", `${of(take)}/subject`, wanted),
  editSubject: (file: string, wanted: SubjectEdit) => json<Done>("PUT", `subjects/${encodeURIComponent(file)}`, wanted),
  subjects: () => get<SubjectView[]>("subjects"),
};

/** A take that came inside the page, which then needs no server. */
const embedded = (globalThis as { markerloomTake?: EmbeddedTake }).markerloomTake;
export const readOnly = embedded !== undefined;

function refused(): never {
  throw new ServerError("refused", "This page shows a take; it is mended in the studio: markerloom view");
}

function offered(data: EmbeddedTake): typeof server {
  const known: Partial<typeof server> = embeddedApi(data);
  return new Proxy(known as typeof server, {
    get: (target, name) => Reflect.get(target, name) ?? (async () => refused()),
  });
}

export const api = embedded === undefined ? server : offered(embedded);

/** What the server tells by itself; reconnects on its own. */
export function listen(told: (notice: Notice) => void, connected: (alive: boolean) => void): void {
  if (readOnly) return;
  const source = new EventSource(`api/notices?token=${encodeURIComponent(token)}`);
  source.onopen = () => connected(true);
  source.onmessage = (event) => told(JSON.parse(event.data));
  source.onerror = () => {
    connected(false);
    // A server that answers with an error ends the stream for good: then it is asked for again.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(told, connected), 1000);
  };
}
