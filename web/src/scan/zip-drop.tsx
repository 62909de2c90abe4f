import { useState } from "preact/hooks";
import { bytes } from "../format";
import { Icon } from "../parts/icon";
import { texts } from "../texts";

interface ZipDropProps {
  file: File | null;
  limit_bytes: number;
  onFile: (file: File | null) => void;
}

/** Why a file cannot be sent, or null when it can. */
export function refusal(file: Pick<File, "name" | "size">, limit_bytes: number): string | null {
  if (!file.name.toLowerCase().endsWith(".zip")) return texts.own.wrongZip(file.name);
  if (file.size > limit_bytes) return texts.own.tooLarge(bytes(file.size), bytes(limit_bytes));
  return null;
}

/** A place to drop a zip on, which is also a file input. */
export function ZipDrop({ file, limit_bytes, onFile }: ZipDropProps) {
  const [over, setOver] = useState(false);
  const [wrong, setWrong] = useState<string | null>(null);
  const take = (offered: File | null | undefined): void => {
    if (!offered) return;
    const reason = refusal(offered, limit_bytes);
    setWrong(reason);
    onFile(reason === null ? offered : null);
  };
  return (
    <div class="stack-1">
      <label
        class={`drop ${over ? "over" : ""} ${wrong ? "bad" : ""}`}
        onDragOver={(event) => {
          event.preventDefault();
          setOver(true);
        }}
        onDragLeave={() => setOver(false)}
        onDrop={(event) => {
          event.preventDefault();
          setOver(false);
          take(event.dataTransfer?.files[0]);
        }}
      >
        <input
          class="visually-hidden"
          id="own-zip"
          type="file"
          accept=".zip,application/zip"
          onChange={(event) => take(event.currentTarget.files?.[0])}
        />
        <Icon name={file ? "check" : "upload"} class={file ? "ok" : ""} />
        <b class="cut">{file ? texts.own.dropped(file.name, bytes(file.size)) : texts.own.drop}</b>
        <span class="small link">{file ? texts.own.another : texts.own.browse}</span>
      </label>
      {wrong && (
        <p class="hint fail" role="alert">
          {wrong}
        </p>
      )}
    </div>
  );
}
