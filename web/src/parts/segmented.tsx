import type { ComponentChildren } from "preact";

interface Choice<Value extends string> {
  value: Value;
  text: ComponentChildren;
  title?: string;
}

interface SegmentedProps<Value extends string> {
  label: string;
  choices: readonly Choice<Value>[];
  value: Value;
  off?: boolean;
  fill?: boolean;
  onChoose: (value: Value) => void;
}

/** One of a few, all in sight. */
export function Segmented<Value extends string>({ label, choices, value, off, fill, onChoose }: SegmentedProps<Value>) {
  return (
    <div class={`segmented ${fill ? "fill" : ""}`} role="group" aria-label={label}>
      {choices.map((choice) => (
        <button
          key={choice.value}
          type="button"
          aria-pressed={choice.value === value}
          aria-disabled={off}
          title={choice.title}
          onClick={() => {
            if (!off) onChoose(choice.value);
          }}
        >
          {choice.text}
        </button>
      ))}
    </div>
  );
}
