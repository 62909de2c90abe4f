import { Icon } from "../parts/icon";
import { texts } from "../texts";

/** The places of the panel: those that work. */
export function Rail() {
  return (
    <nav class="rail" aria-label={texts.pages}>
      <a href="/" aria-current="page">
        <Icon name="scan" />
        {texts.scan}
      </a>
    </nav>
  );
}
