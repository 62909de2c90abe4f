/** What the machine does, drawn for the empty stage. Each laser has the colour of its points. */

import { texts } from "../texts";

export function Sketch() {
  const { sketch } = texts.stage;
  return (
    <svg class="sketch" viewBox="20 -6 572 366" role="img" aria-label={sketch.label}>
      <path class="bed" d="M40 260 398 356 572 182 214 86z" />
      <path class="object" d="M196 239 342 278 342 236 196 197z" />
      <path class="object side" d="M342 278 404 216 404 174 342 236z" />
      <path class="object top" d="M196 197 342 236 404 174 258 135z" />
      <g class="laser1">
        <path class="light" d="M160 16 180 298 230 248 203 199 265 137 325 153 354 124z" />
        <path class="stripe" d="M180 298 230 248 203 199 265 137M325 153 354 124" />
      </g>
      <g class="laser2">
        <path class="light" d="M452 94 258 318 308 269 335 234 397 172 404 173 432 145z" />
        <path class="stripe" d="M258 318 308 269 335 234 397 172M404 173 432 145" />
      </g>
      <g class="cart">
        <path class="arm" d="M160 16 306 55 452 94" />
        <circle cx="160" cy="16" r="13" />
        <circle cx="452" cy="94" r="13" />
        <path class="camera" d="M287 42h38v26h-38zM299 68h14v10h-14z" />
      </g>
      <text x="160" y="20">
        1
      </text>
      <text x="452" y="98">
        2
      </text>
      <text class="word" x="306" y="33">
        {sketch.camera}
      </text>
      <path class="travel" d="M105 305 261 347M241 348 261 347 252 338" />
      <text class="word" x="150" y="344">
        {sketch.travel}
      </text>
    </svg>
  );
}
