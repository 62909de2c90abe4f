/** The place "Scan": start, watch in 3-D, follow, and take the results. */

import { CapturePanel } from "./capture-panel";
import { JobPanel } from "./job-panel";
import { Stage } from "./stage";

export function ScanPage() {
  return (
    <div class="scan-grid">
      <Stage />
      <div class="scan-column">
        <JobPanel />
        <CapturePanel />
      </div>
    </div>
  );
}
