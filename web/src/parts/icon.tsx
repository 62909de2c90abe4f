/** Line icons on a 20 px grid; always beside a word, or inside a control that has a label. */

const PATHS = {
  alert: "M10 3l8 14H2zM10 8v4M10 14.5v.2",
  check: "M4 10.5l4 4 8-9",
  clock: "M10 2.5a7.5 7.5 0 1 0 0 15 7.5 7.5 0 0 0 0-15M10 5.5V10l3 2",
  cross: "M5 5l10 10M15 5L5 15",
  cube: "M10 2.5l6.5 3.7v7.6L10 17.5l-6.5-3.7V6.2zM10 10l6.5-3.8M10 10v7.5M10 10L3.5 6.2",
  dark: "M16 12A7 7 0 0 1 8 4a7 7 0 1 0 8 8z",
  download: "M10 3v9M6 8.5l4 4 4-4M4 16.5h12",
  expand: "M3 7V3h4M13 3h4v4M17 13v4h-4M7 17H3v-4",
  file: "M5 2.5h7l3.5 3.5v11.5H5zM8 10h5M8 13h5",
  info: "M10 2.5a7.5 7.5 0 1 0 0 15 7.5 7.5 0 0 0 0-15M10 9v5M10 6.2v.2",
  light:
    "M10 6.5a3.5 3.5 0 1 0 0 7 3.5 3.5 0 0 0 0-7M10 2v1.5M10 16.5V18M2 10h1.5M16.5 10H18M4.3 4.3l1.1 1.1M14.6 14.6l1.1 1.1M15.7 4.3l-1.1 1.1M5.4 14.6l-1.1 1.1",
  link: "M8 12a3 3 0 0 0 4.3 0l3-3A3 3 0 0 0 11 4.7l-1 1M12 8a3 3 0 0 0-4.3 0l-3 3A3 3 0 0 0 9 15.3l1-1",
  pause: "M7 5v10M13 5v10",
  play: "M6 4l10 6-10 6z",
  retry: "M16 10a6 6 0 1 1-2-4.5M16 3v4h-4",
  scan: "M3 7V4h3M14 4h3v3M17 13v3h-3M6 16H3v-3M3 10h14",
  stop: "M6.5 3h7L17 6.5v7L13.5 17h-7L3 13.5v-7zM7.5 7.5l5 5M12.5 7.5l-5 5",
  stripe: "M10 2v4M10 6l-6 11M10 6l6 11M2.5 17h15",
  system: "M3 4h14v9H3zM10 13v3.5M6.5 16.5h7",
  unlink: "M7 9l-2.5 2.5a3 3 0 0 0 4 4L11 13M9 7l2.5-2.5a3 3 0 0 1 4 4L13 11M4 4l12 12",
  upload: "M10 12.5v-9M6 7l4-4 4 4M4 16.5h12",
} as const;

export type IconName = keyof typeof PATHS;

export function Icon({ name, class: extra = "" }: { name: IconName; class?: string }) {
  return (
    <svg class={`icon ${extra}`} viewBox="0 0 20 20" aria-hidden="true">
      <path d={PATHS[name]} />
    </svg>
  );
}
