import type { ComponentChildren } from "preact";
import { Icon, type IconName } from "./icon";

interface ButtonProps {
  children?: ComponentChildren;
  icon?: IconName;
  kind?: "plain" | "primary" | "ghost";
  size?: "small" | "normal" | "big";
  wide?: boolean;
  /** Why it cannot be pressed. The button stays in the tab order, so that the reason can be reached. */
  off?: string | null;
  busy?: boolean;
  /** Says what an icon alone means. */
  label?: string;
  onPress?: () => void;
  submit?: boolean;
}

export function Button({
  children,
  icon,
  kind = "plain",
  size = "normal",
  wide,
  off,
  busy,
  label,
  onPress,
  submit,
}: ButtonProps) {
  const resting = Boolean(off) || busy === true;
  return (
    <button
      type={submit ? "submit" : "button"}
      class={`button ${kind} ${size} ${wide ? "wide" : ""} ${busy ? "busy" : ""} ${children ? "" : "only-icon"}`}
      aria-disabled={resting}
      aria-busy={busy}
      aria-label={label}
      title={off ?? label}
      onClick={(event) => {
        if (resting) event.preventDefault();
        else onPress?.();
      }}
    >
      {icon && !busy && <Icon name={icon} />}
      {children}
    </button>
  );
}
