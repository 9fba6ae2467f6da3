// A reel as a component of React Three Fiber. Its props are those of any object, and `src`, `onReady` and `options`.
import { useThree } from "@react-three/fiber";
import { SplatReel } from "@splatreel/three";
import React, { useEffect, useState } from "react";

export function Reel({ src, options, onReady, ...props }) {
  const camera = useThree((state) => state.camera);
  const [reel, setReel] = useState(null);
  useEffect(() => {
    const made = new SplatReel(src, options);
    made.addEventListener("loadedmetadata", () => {
      made.quaternion.copy(made.uprightRotation());
      made.viewFromStart(camera);
    });
    made.addEventListener("canplay", () => onReady?.(made));
    setReel(made);
    return () => made.dispose();
    // eslint-disable-next-line react-hooks/exhaustive-deps
  }, [src]);
  return reel && <primitive object={reel} {...props} />;
}
