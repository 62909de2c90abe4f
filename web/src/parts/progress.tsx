interface ProgressProps {
  label: string;
  /** From 0 to 1; null while the whole is not known. */
  share: number | null;
  big?: boolean;
}

export function Progress({ label, share, big }: ProgressProps) {
  const known = share === null ? {} : { "aria-valuenow": Math.round(share * 100) };
  return (
    <div
      class={`progress ${big ? "big" : ""} ${share === null ? "unknown" : ""}`}
      role="progressbar"
      aria-label={label}
      aria-valuemin={0}
      aria-valuemax={100}
      {...known}
    >
      <i style={{ width: share === null ? "30%" : `${(share * 100).toFixed(1)}%` }} />
    </div>
  );
}
