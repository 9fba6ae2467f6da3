import React, { useEffect, useRef } from "react";
import "splatreel-player"; // defines <splat-reel>

/** A reel. React 19 passes attributes and properties to custom elements; events are listened for here. */
export function Reel({ src, label, onTime, onProblem }) {
  const element = useRef(null);

  useEffect(() => {
    const reel = element.current;
    const time = () => onTime?.(reel.currentTime, reel.duration);
    const problem = () => onProblem?.(reel.error.message);
    reel.addEventListener("timeupdate", time);
    reel.addEventListener("loadedmetadata", time);
    reel.addEventListener("error", problem);
    return () => {
      reel.removeEventListener("timeupdate", time);
      reel.removeEventListener("loadedmetadata", time);
      reel.removeEventListener("error", problem);
    };
  }, [onTime, onProblem]);

  const style = { display: "block", width: "100%", maxWidth: "60rem", aspectRatio: "4 / 3" };
  return <splat-reel ref={element} src={src} loop controls aria-label={label} style={style} />;
}
