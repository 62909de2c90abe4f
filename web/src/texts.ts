/**
 * Every word of the panel, in English. A translation is another object of the same shape; numbers arrive already
 * formatted (format.ts).
 */

import type { ColourMode, JobState } from "./api/types";

const colours: Record<ColourMode, string> = {
  height: "Height",
  source: "Source",
  sigma: "Sigma",
  intensity: "Intensity",
  colour: "Colour",
};

const states: Record<JobState, string> = {
  queued: "Waiting",
  running: "Running",
  paused: "Paused",
  cancelling: "Stopping",
  done: "Done",
  failed: "Failed",
  cancelled: "Cancelled",
  interrupted: "Interrupted",
};

export const texts = {
  name: "Twinline",
  skip: "Skip to the page",
  pages: "Pages",
  scan: "Scan",
  close: "Close",

  theme: { label: "Theme", system: "As the system", light: "Light", dark: "Dark" },

  machine: {
    simulated: "simulated scanner",
    simulatedMark: "SIM",
    simulatedWhy: "No machine is connected: nothing moves and no laser is lit.",
  },

  link: {
    label: "Server",
    connecting: "Connecting",
    live: "Connected",
    lost: (age: string) => `No answer, ${age}`,
    banner: (age: string) => `Not connected to the server for ${age}.`,
    asOf: (time: string) => `What you see is from ${time}. Trying again.`,
    never: "Trying again. Is the program still running?",
    refused: "Nothing can be started while the server does not answer.",
  },

  loading: {
    waiting: "Waiting for the server",
    slow: "Still waiting for the server's first answer.",
  },

  job: {
    ready: "Ready",
    nothing: "Nothing scanned yet",
    last: (name: string, points: string) => `Last: ${name} · ${points} points`,
    left: (time: string) => `${time} left`,
    states,
    phases: {
      Rendering: "Render the simulated pass",
      Opening: "Check the capture",
      Reconstructing: "Find stripes and points",
      Writing: "Write files",
    },
    phaseAnnounced: (title: string, phase: string, share: string) => `${title}: ${phase}, ${share}`,
    ended: { done: "finished", failed: "failed", cancelled: "was cancelled", interrupted: "was interrupted" },
    endedAnnounced: (title: string, how: string) => `${title} ${how}.`,
    progress: "Progress",
    starting: "Starting the workers",
    waitsFor: "Waits for its turn",
    pause: "Pause",
    resume: "Continue",
    cancel: "Cancel",
    notAllowed: (command: string, state: string) => `${command} is off: the job is ${state}.`,
    cancelKeeps: "Cancel writes no files; the same job can be started again.",
    next: "Next in the queue",
    again: "Run it again",
    retry: "Try again",
    cancelled: "Cancelled",
    cancelledDetail: "The job was stopped on request and wrote no files.",
    interrupted: "Interrupted",
    interruptedDetail: "The server stopped during the job. The capture is kept; start the job again.",
    failed: "The job stopped",
  },

  demo: {
    title: "Scan something in the next minute",
    intro:
      "No machine is connected, so Twinline simulates one: a cart, two line lasers and a camera over a small scene, with noise and shadows as in a real pass.",
    run: "Run the demo scan",
    scene: "Scene",
    steps: [
      "Render the camera's frames",
      "Find both laser stripes in every frame",
      "Turn them into points in millimetres",
    ],
    panel: "Demo scan",
  },

  own: {
    title: "Your own capture",
    from: "From",
    folder: "Folder",
    zip: "Zip file",
    known: "Used before",
    path: "Folder",
    pathHint: "On the machine where the server runs; it holds capture.json. It is read in place.",
    pathPlaceholder: "/home/me/captures/bust",
    drop: "Drop a zip of a capture folder here",
    browse: "or choose a file",
    dropped: (name: string, size: string) => `${name}, ${size}`,
    another: "Choose another",
    capture: "Capture",
    captureLine: (name: string, frames: string) => `${name} · ${frames} frames`,
    settings: "Settings",
    method: "Stripe method",
    sources: "Lasers",
    every: "Every n-th frame",
    everyHint: "1 uses all frames",
    rig: "Rig",
    rigAuto: "The capture's own, else nominal",
    rigNominal: "Nominal, from capture.json",
    rigFile: "A rig.json file",
    rigChoose: "Choose rig.json",
    rigNone: "No file chosen",
    start: "Reconstruct",
    queue: "Add to the queue",
    busy: {
      opening: "Checking the capture",
      uploading: (share: string) => `Uploading, ${share}`,
      rig: "Sending the rig",
      starting: "Starting",
    },
    needs: {
      path: "Give the path of a capture folder to start.",
      zip: "Choose a zip file to start.",
      known: "Choose a capture to start.",
      sources: "Choose at least one laser to start.",
      every: "Set every n-th frame to a whole number, 1 or more, to start.",
      rig: "Choose the rig.json file to start.",
    },
    wrongZip: (name: string) => `${name} is not a zip file. Pack the capture folder as .zip and choose that.`,
    tooLarge: (size: string, limit: string) => `The file has ${size}; the server takes up to ${limit}.`,
    everyWrong: "A whole number, 1 or more.",
    summary: (method: string, lasers: string, every: string) => `${method} · ${lasers} · ${every}`,
    summaryEvery: (every: string) => (every === "1" ? "all frames" : `1 frame in ${every}`),
  },

  scenes: {
    "three-objects": "Prism, sphere and cylinder",
    "five-pieces": "Five wooden pieces",
    steps: "Blocks of five heights",
    sphere: "Sphere",
    relief: "Face in low relief",
    board: "Calibration board",
  } as Record<string, string>,

  methods: {
    "maximum-likelihood": "Maximum likelihood",
    "brightest-pixel": "Brightest pixel",
    "centre-of-gravity": "Centre of gravity",
    gaussian: "Gaussian fit",
    steger: "Steger",
  } as Record<string, string>,

  sources: {
    laser1: "Laser 1",
    laser2: "Laser 2",
    both: "Both",
    tof: "ToF",
    filled: "Filled",
  } as Record<string, string>,

  stage: {
    title: "3-D",
    label: "Point cloud, to be turned with the mouse",
    colourBy: "Colour by",
    colours,
    colourHints: {
      height: "Height above the bed",
      source: "Which laser a point came from",
      sigma: "Standard deviation of each point: how sure it is",
      intensity: "Brightness of the laser line",
      colour: "Colour of the surface in ambient light",
    } as Record<ColourMode, string>,
    key: (hint: string, key: string) => `${hint} (key ${key})`,
    points: (points: string) => `${points} points`,
    someShown: (shown: string, points: string) => `${shown} of ${points} points`,
    empty: "No points yet",
    sketch: {
      label: "A cart with a camera and two line lasers travels over the object; each laser draws a line on it.",
      camera: "Camera",
      travel: "Travel",
    },
    emptyHint: "Points appear here while a scan is computed. Drag to turn, scroll to zoom.",
    waiting: "Waiting for the first points",
    full: "Full screen",
    colourNote: "Colour of the surface in ambient light",
    legend: (mode: string, min: string, max: string, unit: string) => `${mode} from ${min} to ${max} ${unit}`,
  },

  result: {
    title: "Result",
    points: "Points",
    sigma: "Median sigma",
    sigmaUnit: "mm",
    sigmaHint: "Half of the points are surer than this (one standard deviation)",
    frames: "Frames used",
    framesOf: (used: string, all: string) => `${used} of ${all}`,
    time: "Computed in",
    extent: "Extent",
    heights: "Heights",
    rig: "Rig",
    rigOrigins: {
      given: "given",
      uploaded: "uploaded",
      capture: "of the capture",
      nominal: "nominal, not calibrated",
    } as Record<string, string>,
    method: "Method",
    bySource: "Points by source",
    bySourceLabel: (parts: string) => `Points by source: ${parts}`,
    leftOut: "Left out",
    leftOutHint: "Stripe positions that gave no point, by reason",
    problems: (count: string) => `Frames without points: ${count}`,
    problemsMore: (count: string) => `and ${count} more`,
    warnings: "Warnings",
    download: "Download",
    show: "Show in 3-D",
    files: { "cloud.ply": "PLY", "cloud.glb": "GLB" } as Record<string, string>,
    filesHint: {
      "cloud.ply": "points in mm with sigma, source, intensity",
      "cloud.glb": "points in m for any 3-D viewer",
    } as Record<string, string>,
    fileLabel: (kind: string, size: string) => `Download ${kind}, ${size}`,
  },

  /** One next step for each code; the server's own sentence stands above it. */
  nextSteps: {
    "bad-capture": "Mend the capture folder, then start again.",
    "bad-frame": "Replace the file named above, then start again.",
    "bad-rig": "Choose another rig file, or use the nominal rig.",
    "no-stripe": "Look at the frames: is a laser line visible in them?",
    "bad-input": "Change the setting named above, then start again.",
    "bad-request": "Change the setting named above, then start again.",
    "too-large": "Put the folder on the server's machine and give its path.",
    "unsupported-media-type": "Choose a zip of a capture folder.",
    "cannot-write": "Free some disk space on the server's machine, then try again.",
    "worker-died": "Try again; if it happens again, use fewer frames.",
    "not-found": "It may have been deleted. Reload the page.",
    "not-possible-now": "Wait until the present job has ended.",
    "foreign-origin": "Open the page at the address the server prints when it starts.",
    "foreign-host": "Open the page at the address the server prints when it starts.",
    offline: "Check that the program still runs, then try again.",
    internal: "Try again. The server's log says more.",
  } as Record<string, string>,

  problem: {
    noAnswer: "The server did not answer.",
    unexpected: (status: number) => `The server gave an answer this page does not understand (status ${status}).`,
    dismiss: "Dismiss",
  },
} as const;

/** A text for a name the server may extend: its translation, else the name with spaces. */
export function named(table: Readonly<Record<string, string>>, name: string): string {
  const known = table[name];
  if (known !== undefined) return known;
  const plain = name.replaceAll(/[-_]/g, " ");
  return plain.charAt(0).toUpperCase() + plain.slice(1);
}
