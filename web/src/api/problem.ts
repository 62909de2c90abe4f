/** An error as the server tells it, or the lack of an answer; the only thing that calls of the API throw. */

import { texts } from "../texts";

export interface FieldProblem {
  field: string;
  detail: string;
}

export class ServerProblem extends Error {
  constructor(
    readonly code: string,
    readonly detail: string,
    readonly fields: readonly FieldProblem[] = [],
  ) {
    super(detail);
    this.name = "ServerProblem";
  }
}

/** No answer at all: the server has stopped, or the network has. */
export function noAnswer(): ServerProblem {
  return new ServerProblem("offline", texts.problem.noAnswer);
}

function fieldsOf(value: unknown): FieldProblem[] {
  if (!Array.isArray(value)) return [];
  return value.filter(
    (item): item is FieldProblem =>
      typeof item === "object" && item !== null && typeof item.field === "string" && typeof item.detail === "string",
  );
}

/** Read a problem+json body; anything else becomes a problem that names the status. */
export function problemFrom(body: unknown, status: number): ServerProblem {
  if (typeof body === "object" && body !== null && "code" in body && "detail" in body) {
    const fields = "fields" in body ? fieldsOf(body.fields) : [];
    return new ServerProblem(String(body.code), String(body.detail), fields);
  }
  return new ServerProblem("unexpected-answer", texts.problem.unexpected(status));
}

/** Whatever was thrown, as a problem that can be shown. */
export function asProblem(thrown: unknown): ServerProblem {
  return thrown instanceof ServerProblem ? thrown : noAnswer();
}
