import React, { useCallback, useState } from "react";
import { Reel } from "./Reel.jsx";

export function App() {
  const [status, setStatus] = useState("Loading");
  const onTime = useCallback((time, duration) => setStatus(`${time.toFixed(1)} of ${duration.toFixed(1)} s`), []);
  return (
    <main>
      <Reel src="reel/manifest.json" label="A toy room" onTime={onTime} onProblem={setStatus} />
      <p id="status">{status}</p>
    </main>
  );
}
