import { render } from "preact";
import "./styles/tokens.css";
import "./styles/base.css";
import "./styles/shell.css";
import "./styles/parts.css";
import "./styles/content.css";
import "./styles/scan.css";
import { App } from "./app";
import { follow } from "./state/server";
import { applyTheme } from "./theme";

const root = document.getElementById("app");
if (root === null) throw new Error("index.html has no #app");
applyTheme();
// A file dropped beside its place must not replace the page.
for (const kind of ["dragover", "drop"]) window.addEventListener(kind, (event) => event.preventDefault());
render(<App />, root);
void follow(new AbortController().signal);
