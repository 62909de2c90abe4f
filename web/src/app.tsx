import { ScanPage } from "./scan/page";
import { Bar } from "./shell/bar";
import { Banner, Voice } from "./shell/notices";
import { Rail } from "./shell/rail";
import { texts } from "./texts";

export function App() {
  return (
    <>
      <a class="skip" href="#main">
        {texts.skip}
      </a>
      <div class="shell">
        <Bar />
        <Rail />
        <div class="notice">
          <Banner />
        </div>
        <main class="page" id="main" tabIndex={-1}>
          <ScanPage />
        </main>
      </div>
      <Voice />
    </>
  );
}
