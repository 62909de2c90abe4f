import type { ComponentChildren } from "preact";

interface PanelProps {
  title: string;
  /** Names the region for screen readers and tests. */
  id: string;
  class?: string;
  /** Stands behind the title. */
  sub?: ComponentChildren;
  aside?: ComponentChildren;
  footer?: ComponentChildren;
  children: ComponentChildren;
}

/** A titled box: header, body, and a footer with the main action. */
export function Panel({ title, id, class: extra = "", sub, aside, footer, children }: PanelProps) {
  return (
    <section class={`panel ${extra}`} aria-labelledby={`${id}-title`} id={id} tabIndex={-1}>
      <header>
        <h2 id={`${id}-title`}>{title}</h2>
        {sub}
        <span class="grow" />
        {aside}
      </header>
      {children}
      {footer && <footer>{footer}</footer>}
    </section>
  );
}
