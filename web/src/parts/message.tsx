import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";
import type { ServerProblem } from "../api/problem";
import { texts } from "../texts";
import { Button } from "./button";
import { Icon, type IconName } from "./icon";

interface StateProps {
  icon?: IconName;
  /** In the place of the icon. */
  picture?: ComponentChildren;
  title: string;
  children?: ComponentChildren;
}

/** The middle of a view that has nothing to show. */
export function State({ icon, picture, title, children }: StateProps) {
  return (
    <div class="state">
      {picture}
      {icon && <Icon name={icon} />}
      <h3>{title}</h3>
      {children}
    </div>
  );
}

/** Grey lines in the shape of what comes. */
export function Skeleton({ slow }: { slow: boolean }) {
  return (
    <div class="body stack-2" role="status">
      <span class="visually-hidden">{texts.loading.waiting}</span>
      <div class="skeleton" style={{ width: "60%" }} />
      <div class="skeleton" />
      <div class="skeleton" style={{ width: "85%" }} />
      <div class="skeleton" style={{ width: "40%" }} />
      {slow && <p class="small muted">{texts.loading.slow}</p>}
    </div>
  );
}

interface ProblemNoteProps {
  problem: Pick<ServerProblem, "code" | "detail">;
  onDismiss?: () => void;
}

/** An error in the server's words, its code, and one next step. */
export function ProblemNote({ problem, onDismiss }: ProblemNoteProps) {
  const next = texts.nextSteps[problem.code];
  const note = useRef<HTMLDivElement>(null);
  useEffect(() => note.current?.scrollIntoView({ block: "nearest" }), [problem]);
  return (
    <div class="problem" role="alert" ref={note}>
      <Icon name="stop" class="fail" />
      <div class="grow stack-1">
        <p class="detail">{problem.detail}</p>
        {next && <p class="small soft">{next}</p>}
        <span class="code">{problem.code}</span>
      </div>
      {onDismiss && <Button icon="cross" kind="ghost" size="small" label={texts.problem.dismiss} onPress={onDismiss} />}
    </div>
  );
}
